"""Read-only calls of contracts."""

from __future__ import annotations

from aiohttp import web

from consensus.api_documents import QueryAnswer, QueryRequest
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode_value
from node.api.access.route_access import MEMBER_OR_OWNER
from node.api.routing import JSON, Answer, Body, Call, Route, json_answer


async def _query(call: Call) -> web.StreamResponse:
    asked = await call.document(QueryRequest)
    arguments = decode_value(bytes.fromhex(asked.args))
    if not isinstance(arguments, list):
        raise BlockRobotError("REQUEST_INVALID", "The arguments are not an encoded list.")
    with call.services.ledger.snapshot() as snapshot:
        try:
            result = await call.services.views.run_view(snapshot, asked.contract, asked.view, arguments, call.source)
        except BlockRobotError as error:
            if error.code == "RATE_LIMITED":
                call.services.on_over_budget(str(call.source), error)
            raise
        return json_answer(QueryAnswer(result=result.hex(), height=snapshot.header.height))


ROUTES = (
    Route(
        "POST",
        "/v1/queries",
        "queryContract",
        "Call a read-only entry of a contract on the newest finalized state.",
        MEMBER_OR_OWNER,
        _query,
        Answer(JSON, QueryAnswer, "The encoded result."),
        Body(JSON, QueryRequest, "Contract, view and encoded arguments."),
        errors=(
            "TRANSACTION_CONTRACT_UNKNOWN",
            "CONTRACT_DISABLED",
            "CALL_REFUSED",
            "ENCODING_INVALID",
            "ENCODING_NOT_CANONICAL",
            "VIEWS_BUSY",
            "CONTRACT_WORKER_FAILED",
        ),
    ),
)

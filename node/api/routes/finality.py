"""The newest finalized header and the headers below it. Must never serve a header that is not final."""

from __future__ import annotations

from aiohttp import web

from node.api.access import MEMBER_OR_OWNER
from node.api.documents import PAGE_MAX_COUNT, FinalityAnswer, HeadersAnswer, finality_document
from node.api.routing import JSON, Answer, Call, Parameter, Route, json_answer


async def _get_finality(call: Call) -> web.StreamResponse:
    with call.services.ledger.snapshot() as snapshot:
        return json_answer(FinalityAnswer(height=snapshot.header.height, finality=finality_document(snapshot.finality)))


async def _get_headers(call: Call) -> web.StreamResponse:
    first, limit = call.int_of("from_height"), call.int_of("limit")
    headers: list[str] = []
    with call.services.ledger.snapshot() as snapshot:
        for height in range(first, min(first + limit, snapshot.header.height + 1)):
            block = snapshot.block(height)
            if block is None:
                break
            headers.append(block.header_bytes.hex())
    return json_answer(HeadersAnswer(from_height=first, headers=headers))


ROUTES = (
    Route(
        "GET",
        "/v1/finality",
        "getFinality",
        "The newest finalized header with the proof that it is final.",
        MEMBER_OR_OWNER,
        _get_finality,
        Answer(JSON, FinalityAnswer, "Height and proof."),
    ),
    Route(
        "GET",
        "/v1/headers",
        "getHeaders",
        "Consecutive finalized headers; each names the one before.",
        MEMBER_OR_OWNER,
        _get_headers,
        Answer(JSON, HeadersAnswer, "The headers, lowest first."),
        parameters=(
            Parameter("from_height", "query", "The first height.", default=0),
            Parameter("limit", "query", "How many at most.", None, 1, PAGE_MAX_COUNT, PAGE_MAX_COUNT),
        ),
    ),
)

"""Proofs of the state."""

from __future__ import annotations

from collections.abc import Iterable

from aiohttp import web

from consensus.api_documents import KeyProof, ProofsAnswer, ProofsRequest, finality_document
from consensus.primitives.encoding import encode
from node.api.access.metering import Steps
from node.api.access.principals import require_readable
from node.api.access.route_access import READER
from node.api.routing import JSON, Answer, Body, Call, Route, json_answer
from node.storage.ledger_view import LedgerView


def prove_keys(snapshot: LedgerView, keys: Iterable[bytes]) -> Steps[list[KeyProof]]:
    proofs = []
    for key in keys:
        value = snapshot.get(key)
        proofs.append(
            KeyProof(
                key=key.hex(), value=None if value is None else value.hex(), proof=encode(snapshot.prove(key)).hex()
            )
        )
        yield
    return proofs


def answer_proofs(snapshot: LedgerView, keys: Iterable[bytes]) -> Steps[web.Response]:
    proofs = yield from prove_keys(snapshot, keys)
    return json_answer(ProofsAnswer(finality=finality_document(snapshot.finality), proofs=proofs))


async def _prove(call: Call) -> web.StreamResponse:
    asked = await call.document(ProofsRequest)
    keys = [bytes.fromhex(key) for key in asked.keys]
    session = call.session

    def prove(snapshot: LedgerView) -> Steps[web.Response]:
        if session is not None:
            require_readable(snapshot, session.kind, session.public_key, session.grant_id, keys)
        return (yield from answer_proofs(snapshot, keys))

    return await call.read(prove)


ROUTES = (
    Route(
        "POST",
        "/v1/state-proofs",
        "proveState",
        "Prove presence or absence of keys of the state, all under one finalized root.",
        READER,
        _prove,
        Answer(JSON, ProofsAnswer, "Values and proofs, in the order of the keys."),
        Body(JSON, ProofsRequest, "The flat keys."),
    ),
)

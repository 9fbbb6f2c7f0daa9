"""Proofs of the state. Must never mix two snapshots in one answer."""

from __future__ import annotations

from collections.abc import Iterable

from aiohttp import web

from consensus.primitives.encoding import encode
from node.api.access import READER
from node.api.documents import KeyProof, ProofsAnswer, ProofsRequest, finality_document
from node.api.routing import JSON, Answer, Body, Call, Route, json_answer
from node.api.services import LedgerSnapshot
from node.api.standing import require_readable


def prove_keys(snapshot: LedgerSnapshot, keys: Iterable[bytes]) -> list[KeyProof]:
    """Return value and proof of each flat key under the snapshot's state root."""
    proofs = []
    for key in keys:
        value = snapshot.get(key)
        proofs.append(
            KeyProof(
                key=key.hex(), value=None if value is None else value.hex(), proof=encode(snapshot.prove(key)).hex()
            )
        )
    return proofs


async def _prove(call: Call) -> web.StreamResponse:
    asked = await call.document(ProofsRequest)
    keys = [bytes.fromhex(key) for key in asked.keys]
    with call.services.ledger.snapshot() as snapshot:
        if call.session is not None:
            require_readable(snapshot, call.session.kind, call.caller, call.session.grant_id, keys)
        return json_answer(
            ProofsAnswer(
                finality=finality_document(snapshot.finality),
                proofs=prove_keys(snapshot, keys),
            )
        )


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

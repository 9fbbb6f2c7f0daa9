"""Organisations and their privacy notices, with proofs, for anyone."""

from __future__ import annotations

from aiohttp import web

from consensus.api_documents import ProofsAnswer, ProofsRequest
from consensus.errors import BlockRobotError
from consensus.state.consent import NOTICE, NOTICE_TEXT
from consensus.state.identity import CUSTODIAN, REGISTRAR
from node.api.access.route_access import ANYONE
from node.api.routes.proofs import answer_proofs
from node.api.routing import JSON, Answer, Body, Call, Route

PUBLIC_KEYS_MAX_COUNT = 8
PUBLIC_PREFIXES = (
    NOTICE.flat,
    NOTICE_TEXT.flat,
    CUSTODIAN.flat,
    REGISTRAR.flat,
)
"""Keys about organisations, their nodes and their words. What stands below them names nobody who is recorded."""


async def _prove_public(call: Call) -> web.StreamResponse:
    asked = await call.document(ProofsRequest)
    keys = [bytes.fromhex(key) for key in asked.keys]
    if len(keys) > PUBLIC_KEYS_MAX_COUNT:
        raise BlockRobotError("REQUEST_INVALID", f"Without a session at most {PUBLIC_KEYS_MAX_COUNT} keys are proved.")
    if not all(key.startswith(PUBLIC_PREFIXES) for key in keys):
        raise BlockRobotError("NOT_PERMITTED", "Without a session only notices, registrars and custodians are proved.")
    return await call.read(lambda snapshot: answer_proofs(snapshot, keys))


ROUTES = (
    Route(
        "POST",
        "/v1/notice-proofs",
        "proveNotices",
        "Prove privacy notices, registrars and custodians, all under one finalized root.",
        ANYONE,
        _prove_public,
        Answer(JSON, ProofsAnswer, "Values and proofs, in the order of the keys."),
        Body(JSON, ProofsRequest, "The flat keys, at most eight."),
        errors=("NOT_PERMITTED",),
    ),
)

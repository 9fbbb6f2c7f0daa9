"""Challenges and sessions."""

from __future__ import annotations

from aiohttp import web

from consensus.api_documents import ChallengeAnswer, ChallengeRequest, SessionAnswer, SessionRequest
from node.api.access.route_access import ANYONE, READER
from node.api.routing import JSON, Answer, Body, Call, Route, json_answer

_BODY_MAX_BYTES = 1024


async def _create_challenge(call: Call) -> web.StreamResponse:
    asked = await call.document(ChallengeRequest)
    challenge, expires_at_ms = call.sessions.challenge(bytes.fromhex(asked.public_key))
    return json_answer(ChallengeAnswer(challenge=challenge.hex(), expires_at_ms=expires_at_ms))


async def _create_session(call: Call) -> web.StreamResponse:
    asked = await call.document(SessionRequest)
    key, challenge, signature = (bytes.fromhex(part) for part in (asked.public_key, asked.challenge, asked.signature))
    token, session = call.sessions.open(key, challenge, signature, bytes.fromhex(asked.grant or ""))
    return json_answer(SessionAnswer(token=token.hex(), kind=session.kind, expires_at_ms=session.expires_at_ms))


async def _delete_session(call: Call) -> web.StreamResponse:
    call.sessions.close(bytes.fromhex(call.http.headers["Authorization"].removeprefix("Bearer ")))
    return web.Response(status=204)


ROUTES = (
    Route(
        "POST",
        "/v1/session-challenges",
        "createSessionChallenge",
        "A single-use challenge for a key; valid for 60 seconds.",
        ANYONE,
        _create_challenge,
        Answer(JSON, ChallengeAnswer, "The challenge."),
        Body(JSON, ChallengeRequest, "The key that will sign.", _BODY_MAX_BYTES),
        errors=("KEY_INVALID",),
    ),
    Route(
        "POST",
        "/v1/sessions",
        "createSession",
        "Open a session with a signed challenge; it lasts ten minutes. The signature is recoverable, over the tagged "
        "hash blockrobot/session of chain id, node name, challenge and public key. Who opens it by the one-time key of a "
        "grant names the grant.",
        ANYONE,
        _create_session,
        Answer(JSON, SessionAnswer, "The session's token: send it as `Authorization: Bearer TOKEN`."),
        Body(JSON, SessionRequest, "The signed challenge.", _BODY_MAX_BYTES),
        errors=("CHALLENGE_INVALID", "SIGNATURE_INVALID", "SIGNATURE_HIGH_S", "SESSION_REFUSED"),
    ),
    Route(
        "DELETE",
        "/v1/sessions",
        "deleteSession",
        "Close the session that the request is made in.",
        READER,
        _delete_session,
        Answer(JSON, None, "The session is closed.", 204),
    ),
)

"""Recorded empty frames, named by their hash."""

from __future__ import annotations

from aiohttp import web

from consensus.api_documents import BackgroundAnswer
from consensus.errors import BlockRobotError
from consensus.primitives.hashing import sha256
from node.api.access.route_access import ROBOT, VIEWER
from node.api.routes.custody.clips import custody_of
from node.api.routing import BYTES, JSON, Answer, Body, Call, Parameter, Route, bytes_answer, json_answer

BACKGROUND_MAX_BYTES = 4 * 1024 * 1024
_DIGEST = Parameter("sha256", "path", "The SHA-256 of the content.", 32)


async def _put(call: Call) -> web.StreamResponse:
    custody = custody_of(call)
    digest = call.bytes_of("sha256")
    async with custody.admission.background(digest, call.body_size_bytes, call.caller):
        content = await call.body()
        if not content or sha256(content) != digest:
            raise BlockRobotError("UPLOAD_HASH_MISMATCH")
        await custody.put_background(digest, content, call.caller)
    return json_answer(BackgroundAnswer(sha256=digest.hex()))


async def _get(call: Call) -> web.StreamResponse:
    content = await custody_of(call).get_background(call.bytes_of("sha256"))
    if content is None:
        raise BlockRobotError("NOT_FOUND", "No empty frame has this hash.")
    return bytes_answer(content, BYTES)


ROUTES = (
    Route(
        "PUT",
        "/v1/backgrounds/{sha256}",
        "putBackground",
        "Store an empty frame, a depth picture that is approved on the chain, under its hash. Repeating is harmless.",
        ROBOT,
        _put,
        Answer(JSON, BackgroundAnswer, "It is stored."),
        Body(BYTES, None, "The picture's bytes.", BACKGROUND_MAX_BYTES),
        (_DIGEST,),
        (
            "UPLOAD_HASH_MISMATCH",
            "EMPTY_FRAME_NOT_APPROVED",
            "BACKGROUND_NOT_A_PICTURE",
            "UPLOAD_QUOTA_EXCEEDED",
            "DISK_RESERVE_REACHED",
            "CUSTODY_ELSEWHERE",
            "STORE_UNAVAILABLE",
        ),
    ),
    Route(
        "GET",
        "/v1/backgrounds/{sha256}",
        "getBackground",
        "Fetch a recorded empty frame.",
        VIEWER,
        _get,
        Answer(BYTES, None, "The picture's bytes."),
        None,
        (_DIGEST,),
        ("NOT_FOUND", "CUSTODY_CATCHING_UP", "CUSTODY_ELSEWHERE", "STORE_UNAVAILABLE"),
    ),
)

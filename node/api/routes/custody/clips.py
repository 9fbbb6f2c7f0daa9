"""Clips: robots upload them, owners fetch them."""

from __future__ import annotations

from aiohttp import web

from consensus.api_documents import UploadAnswer
from consensus.errors import BlockRobotError
from consensus.limits import CLIP_SIZE_MAX_BYTES
from consensus.primitives.encoding import decode, encode
from consensus.records.clips import ClipUpload
from consensus.state.records import RECORD, decided_root
from node.api.access.route_access import OWNER, ROBOT
from node.api.ports import CustodyService
from node.api.routing import JSON, MSGPACK, Answer, Body, Call, Parameter, Route, bytes_answer, json_answer

_OVERHEAD_BYTES = 64 * 1024
_RECORD_ID = Parameter("record_id", "path", "The record's id.", 16)
_OWNER = Parameter("owner", "query", "The first key of the visit, as the upload has it; judged before the body.", 33)


def custody_of(call: Call) -> CustodyService:
    """Raises CUSTODY_ELSEWHERE."""
    if call.services.custody is None:
        raise BlockRobotError("CUSTODY_ELSEWHERE")
    return call.services.custody


async def _upload(call: Call) -> web.StreamResponse:
    custody = custody_of(call)
    record_id, owner = call.bytes_of("record_id"), call.bytes_of("owner")
    async with custody.admission.clip(record_id, owner, call.body_size_bytes, call.caller) as is_new:
        upload = decode(await call.body(), ClipUpload)
        if (upload.record_id, upload.owner) != (record_id, owner):
            raise BlockRobotError("UPLOAD_INVALID", "The upload is for another record or visit than its address says.")
        await custody.stage(upload, call.caller, is_new=is_new)
    return json_answer(UploadAnswer(record_id=record_id.hex(), status="staged"))


async def _download(call: Call) -> web.StreamResponse:
    custody = custody_of(call)
    record_id, access_id = call.bytes_of("record_id"), call.bytes_of("access_id")
    with call.services.ledger.snapshot() as snapshot:
        record = RECORD.at(snapshot, record_id)
        root = decided_root(snapshot, call.caller)
    if record is None:
        raise BlockRobotError("NOT_FOUND", "There is no record of this id.")
    if root is None or record.owner != root:
        raise BlockRobotError("NOT_PERMITTED", "The record belongs to another owner key.")
    return bytes_answer(encode(await custody.download(record_id, access_id, root)), MSGPACK)


ROUTES = (
    Route(
        "PUT",
        "/v1/clips/{record_id}",
        "uploadClip",
        "Stage a clip's ciphertext before its record is submitted. Repeating the same upload is harmless.",
        ROBOT,
        _upload,
        Answer(JSON, UploadAnswer, "The clip is staged."),
        Body(MSGPACK, None, "A canonical ClipUpload.", CLIP_SIZE_MAX_BYTES + _OVERHEAD_BYTES),
        (_RECORD_ID, _OWNER),
        (
            "ENCODING_INVALID",
            "ENCODING_NOT_CANONICAL",
            "UPLOAD_INVALID",
            "UPLOAD_CONFLICT",
            "UPLOAD_HASH_MISMATCH",
            "UPLOAD_QUOTA_EXCEEDED",
            "VISIT_NOT_OPEN",
            "CLIP_ERASED",
            "TRANSACTION_EXPIRED",
            "DISK_RESERVE_REACHED",
            "CUSTODY_ELSEWHERE",
            "STORE_UNAVAILABLE",
            "ERASE_KEYS_DAMAGED",
        ),
    ),
    Route(
        "GET",
        "/v1/clips/{record_id}",
        "downloadClip",
        "Fetch a clip under a final access transaction of its owner key.",
        OWNER,
        _download,
        Answer(MSGPACK, None, "A canonical ClipDownload."),
        None,
        (_RECORD_ID, Parameter("access_id", "query", "The txid of the final access request.", 32)),
        (
            "NOT_FOUND",
            "ACCESS_NOT_GRANTED",
            "ACCESS_ENDED",
            "CLIP_NOT_CONFIRMED",
            "CLIP_ERASED",
            "CLIP_QUARANTINED",
            "CUSTODY_CATCHING_UP",
            "CUSTODY_ELSEWHERE",
            "STORE_UNAVAILABLE",
            "ERASE_KEYS_DAMAGED",
        ),
    ),
)

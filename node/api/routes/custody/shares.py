"""Shares: owners upload parts of keys, grantees fetch shared clips."""

from __future__ import annotations

from aiohttp import web

from consensus.api_documents import UploadAnswer
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode, encode
from consensus.records.sharing import GrantUpload, SharedRequest, check_grant_upload
from consensus.state.records import RECORD, decided_root
from node.api.access.route_access import GRANTEE, OWNER
from node.api.routes.custody.clips import custody_of
from node.api.routing import JSON, MSGPACK, Answer, Body, Call, Parameter, Route, bytes_answer, json_answer

_UPLOAD_MAX_BYTES = 16 * 1024
_REQUEST_MAX_BYTES = 1024
_PARAMETERS = (
    Parameter("grant_id", "path", "The grant's id: the txid of its transaction.", 32),
    Parameter("record_id", "path", "The record's id.", 16),
)


async def _upload(call: Call) -> web.StreamResponse:
    custody = custody_of(call)
    grant_id, record_id = call.bytes_of("grant_id"), call.bytes_of("record_id")
    upload = decode(await call.body(), GrantUpload)
    if (upload.grant_txid, upload.record_id) != (grant_id, record_id):
        raise BlockRobotError("UPLOAD_INVALID", "The upload is for another grant or record than its address says.")
    check_grant_upload(upload)
    with call.services.ledger.snapshot() as snapshot:
        record = RECORD.at(snapshot, record_id)
        root = decided_root(snapshot, call.caller)
    if record is None:
        raise BlockRobotError("NOT_FOUND", "There is no record of this id.")
    if root is None or record.owner != root:
        raise BlockRobotError("NOT_PERMITTED", "The record belongs to another owner key.")
    return json_answer(UploadAnswer(record_id=record_id.hex(), status=await custody.stage_part(upload, root)))


async def _download(call: Call) -> web.StreamResponse:
    custody = custody_of(call)
    grant_id, record_id = call.bytes_of("grant_id"), call.bytes_of("record_id")
    request = decode(await call.body(), SharedRequest)
    if request.record_id != record_id:
        raise BlockRobotError("UPLOAD_INVALID", "The request is for another record than its address says.")
    return bytes_answer(encode(await custody.download_shared(request, grant_id, call.caller)), MSGPACK)


_PATH = "/v1/grants/{grant_id}/{record_id}"
_ERRORS = (
    "ENCODING_INVALID",
    "ENCODING_NOT_CANONICAL",
    "UPLOAD_INVALID",
    "NOT_FOUND",
    "GRANT_ENDED",
    "CLIP_NOT_CONFIRMED",
    "CLIP_ERASED",
    "CLIP_QUARANTINED",
    "CUSTODY_ELSEWHERE",
    "STORE_UNAVAILABLE",
    "ERASE_KEYS_DAMAGED",
)
"""What both say of a grant and its clip."""

ROUTES = (
    Route(
        "PUT",
        _PATH,
        "uploadKeyPart",
        "Bring this custodian its part of a shared record's key, before the grant is final or while it stands. "
        "Repeating the same upload is harmless.",
        OWNER,
        _upload,
        Answer(JSON, UploadAnswer, "The part is kept: `staged` until the grant is final, else `confirmed`."),
        Body(MSGPACK, None, "A canonical GrantUpload.", _UPLOAD_MAX_BYTES),
        _PARAMETERS,
        (*_ERRORS, "UPLOAD_CONFLICT", "TRANSACTION_EXPIRED", "DISK_RESERVE_REACHED"),
    ),
    Route(
        "POST",
        _PATH,
        "downloadSharedClip",
        "Fetch a shared clip, its package and this custodian's parts of the key, under a final request by the grantee. "
        "The body shows who they are; without frames it fetches package and parts only.",
        GRANTEE,
        _download,
        Answer(MSGPACK, None, "A canonical SharedDownload."),
        Body(MSGPACK, None, "A canonical SharedRequest.", _REQUEST_MAX_BYTES),
        _PARAMETERS,
        (
            *_ERRORS,
            "ACCESS_NOT_GRANTED",
            "ACCESS_ENDED",
            "GRANT_PARTS_MISSING",
            "GRANTEE_NOT_A_MEMBER",
            "CUSTODY_CATCHING_UP",
        ),
    ),
)

"""Access: an owner asks, custodians release or refuse, the owner judges. Must never let a release stand without a request.

access/id -> {owner, records, purpose, time, released, refused}, the id being the request's txid and an empty list of
records the whole visit; verdict/record id -> {verdict, frames, time}; release/id+hash of custodian and records -> True.
"""

KEY_BYTES = 33
ID_BYTES = 32
FRAMES_MAX_COUNT = 64
CODE_MAX_CHARS = 64
VERDICTS = ("verified", "corrupted")


@export
def request(records: list, purpose: str):
    """Ask for records of one's own visit (none named: all of it). Who may call: the visit's owner key."""
    require(call("identity", "purpose_known", purpose), "PURPOSE_UNKNOWN", "The purpose is not published.")
    owner = call("records", "root_of", ctx.caller)
    call("records", "require_records", owner, records, False)
    call("rights", "require_release", owner, records, purpose)
    entry = {
        "owner": owner,
        "records": records,
        "purpose": purpose,
        "time": ctx.time,
        "released": {},
        "refused": {},
    }
    state.put(b"access/" + ctx.txid, entry)
    subject = b""
    if len(records) == 1:
        subject = records[0]
    data = {"access_id": ctx.txid, "records": len(records), "purpose": purpose}
    call("audit", "append", owner, subject, "access_requested", data)
    emit("requested", {"access_id": ctx.txid, "owner": owner, "records": records, "purpose": purpose})


def require_access(access_id: bytes) -> dict:
    require(call("identity", "is_custodian", ctx.caller), "NOT_A_CUSTODIAN", "Only a custodian may do that.")
    require(len(access_id) == ID_BYTES, "ACCESS_UNKNOWN", "An access id has 32 bytes.")
    entry = state.get(b"access/" + access_id)
    require(entry is not None, "ACCESS_UNKNOWN", "There is no such access request.")
    return entry


@export
def released(access_id: bytes, record_ids: list):
    """Say which records (1 to 64) were handed out. Who may call: a custodian, once for the same records.

    A custodian that was restarted may not know what it sent already: the audit must not show two releases then.
    """
    entry = require_access(access_id)
    require(len(record_ids) > 0, "RECORDS_MISSING", "No record is named.")
    call("records", "require_records", entry["owner"], record_ids, True)
    if len(entry["records"]) > 0:
        for record_id in record_ids:
            require(record_id in entry["records"], "RECORD_NOT_REQUESTED", "The request does not name this record.")
    told = ctx.caller
    for record_id in record_ids:
        told += record_id
    told = b"release/" + access_id + sha256(told)
    require(not state.has(told), "RELEASE_EXISTS", "The custodian has said so already.")
    state.put(told, True)
    entry["released"][ctx.caller] = entry["released"].get(ctx.caller, 0) + len(record_ids)
    state.put(b"access/" + access_id, entry)
    subject = b""
    if len(record_ids) == 1:
        subject = record_ids[0]
    data = {"access_id": access_id, "custodian": ctx.caller, "records": len(record_ids)}
    call("audit", "append", entry["owner"], subject, "access_released", data)
    emit("released", {"access_id": access_id, "custodian": ctx.caller, "records": record_ids})


@export
def refused(access_id: bytes, code: str):
    """Say that a request was refused, and why (a code). Who may call: a custodian, once."""
    entry = require_access(access_id)
    require(0 < len(code) and len(code) <= CODE_MAX_CHARS, "CODE_WRONG", "A code has 1 to 64 characters.")
    require(ctx.caller not in entry["refused"], "REFUSAL_EXISTS", "The custodian has refused already.")
    entry["refused"][ctx.caller] = code
    state.put(b"access/" + access_id, entry)
    data = {"access_id": access_id, "custodian": ctx.caller, "code": code}
    call("audit", "append", entry["owner"], b"", "access_refused", data)
    emit("refused", data)


@export
def verdict(record_id: bytes, judgement: str, frames: list):
    """Say whether what was released is what the robot committed to. Who may call: the record's owner key."""
    require(judgement in VERDICTS, "VERDICT_UNKNOWN", "A verdict is verified or corrupted.")
    require(len(frames) <= FRAMES_MAX_COUNT, "FRAMES_WRONG", "A clip has at most 64 frames.")
    for frame in frames:
        require(isinstance(frame, int) and frame >= 0 and frame < FRAMES_MAX_COUNT, "FRAMES_WRONG", "No such frame.")
    owner = call("records", "root_of", ctx.caller)
    call("records", "require_records", owner, [record_id], True)
    state.put(b"verdict/" + record_id, {"verdict": judgement, "frames": frames, "time": ctx.time})
    call("audit", "append", owner, record_id, "verdict", {"verdict": judgement, "frames": frames})
    emit("verdict", {"record_id": record_id, "owner": owner, "verdict": judgement, "frames": frames})


@view
def get(access_id: bytes) -> dict | None:
    """Return an access request's state, or None."""
    return state.get(b"access/" + access_id)


@view
def verdict_of(record_id: bytes) -> dict | None:
    """Return the last verdict on a record, or None."""
    return state.get(b"verdict/" + record_id)

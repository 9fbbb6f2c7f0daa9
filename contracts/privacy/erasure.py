"""Erasure: an owner asks, every custodian destroys and signs a receipt. Must never call erased what one still holds.

What it keeps: docs/reference/state.md.
"""

ID_BYTES = 32
HASH_BYTES = 32
FRAMES_MAX_COUNT = 64
DESTROYED_MAX_COUNT = 4096
REMAINS_MAX_CHARS = 256
DECIDING = ("officers", "rights")


@export
def request(records: list, frames: list):
    """Ask for the erasure of 1 to 64 records, or of frames of one. Who may call: the records' owner key."""
    for frame in frames:
        require(isinstance(frame, int) and frame >= 0 and frame < FRAMES_MAX_COUNT, "FRAMES_WRONG", "No such frame.")
    require(len(frames) <= FRAMES_MAX_COUNT, "FRAMES_WRONG", "A clip has at most 64 frames.")
    require(len(frames) == 0 or len(records) == 1, "FRAMES_WRONG", "Frames are erased of one record at a time.")
    owner = call("records", "root_of", ctx.caller)
    call("rights", "require_open", owner)
    begin(owner, records, frames)


@export
def order(owner: bytes, records: list):
    """Ask for the erasure of 1 to 64 records that officers decided. Who may call: the contracts by which officers decide."""
    require(ctx.calling_contract in DECIDING, "NOT_A_DECIDING_CONTRACT", "Only the contracts of the officers may do that.")
    begin(owner, records, [])


def begin(owner: bytes, records: list, frames: list):
    check_unlike(records)
    call("records", "begin_erasure", owner, records, frames)
    entry = {
        "owner": owner,
        "records": records,
        "frames": frames,
        "custodians": call("identity", "custodians"),
        "receipts": {},
        "status": "requested",
        "time": ctx.time,
    }
    note(owner, records, "erasure_requested", {"erasure_id": ctx.txid, "records": len(records), "frames": frames})
    emit("requested", {"erasure_id": ctx.txid, "owner": owner, "records": records, "frames": frames})
    put_or_complete(ctx.txid, entry)


def check_unlike(records: list):
    seen = {}
    for record_id in records:
        require(isinstance(record_id, bytes) and record_id not in seen, "RECORD_ID_WRONG", "A record is named twice.")
        seen[record_id] = True


def note(owner: bytes, records: list, kind: str, data: dict):
    subject = b""
    if len(records) == 1:
        subject = records[0]
    call("audit", "append", owner, subject, kind, data)


def put_or_complete(erasure_id: bytes, entry: dict):
    """Store a request; once every custodian has confirmed, it is complete and the records are reduced."""
    if len(entry["receipts"]) == len(entry["custodians"]):
        entry["status"] = "complete"
        call("records", "complete_erasure", entry["records"], entry["frames"])
        note(entry["owner"], entry["records"], "erasure_complete", {"erasure_id": erasure_id})
    state.put(b"erasure/" + erasure_id, entry)


@export
def receipt(erasure_id: bytes, destroyed_frames: int, remains: str, remains_until_ms: int, digest: bytes):
    """Say that the keys are destroyed, what remains and until when. Who may call: a custodian of the request, once."""
    require(len(erasure_id) == ID_BYTES, "ERASURE_UNKNOWN", "An erasure id has 32 bytes.")
    require(call("identity", "is_custodian", ctx.caller), "NOT_A_CUSTODIAN", "Only a custodian may do that.")
    entry = state.get(b"erasure/" + erasure_id)
    require(entry is not None, "ERASURE_UNKNOWN", "There is no such erasure request.")
    require(ctx.caller in entry["custodians"], "NOT_A_CUSTODIAN", "The custodian came after this request.")
    require(ctx.caller not in entry["receipts"], "RECEIPT_EXISTS", "The custodian has confirmed already.")
    known = destroyed_frames >= 0 and destroyed_frames <= DESTROYED_MAX_COUNT
    require(known, "RECEIPT_WRONG", "The number of destroyed frames is out of range.")
    require(len(remains) <= REMAINS_MAX_CHARS, "RECEIPT_WRONG", "What remains is told in at most 256 characters.")
    require(remains_until_ms >= 0 and remains_until_ms < 9007199254740992, "RECEIPT_WRONG", "The time is out of range.")
    require(len(digest) == HASH_BYTES, "RECEIPT_WRONG", "A digest has 32 bytes.")
    told = {
        "destroyed_frames": destroyed_frames,
        "remains": remains,
        "remains_until_ms": remains_until_ms,
        "digest": digest,
        "time": ctx.time,
    }
    entry["receipts"][ctx.caller] = told
    data = {"erasure_id": erasure_id, "custodian": ctx.caller, "destroyed_frames": destroyed_frames, "remains": remains}
    note(entry["owner"], entry["records"], "erasure_receipted", data)
    put_or_complete(erasure_id, entry)
    emit("receipted", {"erasure_id": erasure_id, "custodian": ctx.caller, "status": entry["status"]})


@export
def expired(record_ids: list, digest: bytes):
    """Say that 1 to 64 expired records were destroyed unasked, or were never here. Who may call: a custodian.

    Saying it again changes nothing, but where another that was awaited is no custodian any more.
    """
    require(call("identity", "is_custodian", ctx.caller), "NOT_A_CUSTODIAN", "Only a custodian may do that.")
    require(len(digest) == HASH_BYTES, "RECEIPT_WRONG", "A digest has 32 bytes.")
    check_unlike(record_ids)
    for owner in call("records", "expire", record_ids, ctx.caller, call("identity", "custodians")):
        call("audit", "append", owner, b"", "expired", {"custodian": ctx.caller, "digest": digest})
    emit("expired", {"record_ids": record_ids, "custodian": ctx.caller})


@view
def get(erasure_id: bytes) -> dict | None:
    """Return an erasure request's state, or None."""
    return state.get(b"erasure/" + erasure_id)

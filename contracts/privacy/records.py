"""Visits and records: what robots recorded, of whom only one-time owner keys tell. Must never hold a member key of a subject.

A visit can be transferred to a new owner key, after a theft. Whatever is kept of it stays under its first key, its root.

A record's status goes active -> erasing -> erased (asked for), or active -> expired -> erased (by itself). From "expired"
or "erased" on its roots and metadata are gone. `awaited` lists who has yet to report its expiry: those who were custodians
at the first report, since who comes later finds nothing of it any more. What it keeps: docs/reference/state.md.
"""

KEY_BYTES = 33
ID_BYTES = 16
HASH_BYTES = 32
SEALED_METADATA_BYTES = 560
BUCKET_MS = 300000
BUCKET_AHEAD_MAX_MS = 300000
BUCKET_AGE_MAX_MS = 86400000
VISIT_MAX_MS = 600000
RETENTION_MAX_MS = 31622400000
RECORDS_A_CALL_MAX_COUNT = 64
RECORD_COUNT_MAX = 100000
SCAN_MAX_COUNT = 256
SCAN_PART_COUNT = 32
TRANSFERS_MAX_COUNT = 64
EMPTY_FRAMES_MAX_COUNT = 128
EMPTY_FRAMES_A_CALL_MAX_COUNT = 32
RECORD_TAG = "blockrobot/record-id"
TRANSFER_TAG = "blockrobot/transfer"


def require_robot():
    require(call("identity", "role_of", ctx.caller) == "robot", "NOT_A_ROBOT", "Only an active robot may do that.")


def check_bucket(bucket_ms: int):
    """A bucket is five whole minutes, not ahead, and a day old at most: a robot's spool outlasts a cut of the network."""
    require(bucket_ms >= 0 and bucket_ms % BUCKET_MS == 0, "BUCKET_WRONG", "A bucket begins on five full minutes.")
    require(bucket_ms <= ctx.time + BUCKET_AHEAD_MAX_MS, "BUCKET_WRONG", "The bucket lies ahead.")
    require(bucket_ms >= ctx.time - BUCKET_AGE_MAX_MS, "BUCKET_WRONG", "The bucket is more than a day old.")


def check_new_keys(owner: bytes, ephemeral: bytes, view_tag: int):
    require(len(owner) == KEY_BYTES and len(ephemeral) == KEY_BYTES, "KEY_SIZE_WRONG", "O and R have 33 bytes each.")
    require(view_tag >= 0 and view_tag < 256, "VIEW_TAG_WRONG", "A view tag is one byte.")


def require_unused(owner: bytes):
    """What was shared with a key does not count: whoever sees the call on its way could share with it first."""
    require(not is_owner_key(owner), "VISIT_EXISTS", "There is, or was, a visit under this owner key.")


def announce(parts: list) -> int:
    """Write the next announcement and return its number."""
    sequence = state.get(b"announcement-count", 0)
    state.put(b"announcement-count", sequence + 1)
    state.put(b"announcement/" + u64(sequence), parts)
    return sequence


@export
def open_visit(owner: bytes, ephemeral: bytes, view_tag: int, bucket_ms: int, purpose: str):
    """Open a visit under a one-time owner key. Who may call: a robot."""
    require_robot()
    check_new_keys(owner, ephemeral, view_tag)
    check_bucket(bucket_ms)
    require(call("identity", "purpose_known", purpose), "PURPOSE_UNKNOWN", "The purpose is not published.")
    require_unused(owner)
    sequence = announce([owner, ephemeral, view_tag, bucket_ms, ctx.caller])
    opened = {
        "robot": ctx.caller,
        "ephemeral": ephemeral,
        "view_tag": view_tag,
        "bucket_ms": bucket_ms,
        "purpose": purpose,
        "status": "open",
        "record_count": 0,
        "height": ctx.height,
        "sequence": sequence,
    }
    state.put(b"visit/" + owner, opened)
    call("audit", "append", owner, b"", "visit_opened", {"purpose": purpose})
    data = {"owner": owner, "ephemeral": ephemeral, "view_tag": view_tag, "bucket_ms": bucket_ms, "sequence": sequence}
    emit("visit_opened", data)


def require_open_visit(owner: bytes) -> dict:
    require(len(owner) == KEY_BYTES, "KEY_SIZE_WRONG", "O has 33 bytes.")
    opened = state.get(b"visit/" + owner)
    require(opened is not None, "VISIT_UNKNOWN", "There is no visit under this owner key.")
    require(opened["robot"] == ctx.caller, "NOT_THE_ROBOT", "Another robot opened this visit.")
    require(opened["status"] == "open", "VISIT_CLOSED", "The visit is closed.")
    return opened


@export
def record(
    record_id: bytes,
    owner: bytes,
    commitment_root: bytes,
    ciphertext_root: bytes,
    sealed_metadata: bytes,
    bucket_ms: int,
    expires_at_ms: int,
):
    """Commit to one clip of one owner. Who may call: the robot that opened the owner's visit, while it is open.

    The id is derived from the owner key and the frames' commitments, so nobody can take the id of another robot's record.
    """
    require_robot()
    opened = require_open_visit(owner)
    require(len(commitment_root) == HASH_BYTES and len(ciphertext_root) == HASH_BYTES, "ROOT_WRONG", "A root has 32 bytes.")
    derived = tagged_hash(RECORD_TAG, owner + commitment_root)[:ID_BYTES]
    require(record_id == derived, "RECORD_ID_WRONG", "A record's id follows from its owner key and commitment root.")
    require(len(sealed_metadata) == SEALED_METADATA_BYTES, "METADATA_WRONG", "Sealed metadata has 560 bytes.")
    check_bucket(bucket_ms)
    late = bucket_ms - opened["bucket_ms"]
    require(late >= 0 and late <= VISIT_MAX_MS + BUCKET_MS, "VISIT_TOO_LONG", "A visit lasts at most ten minutes.")
    require(expires_at_ms > ctx.time, "EXPIRY_WRONG", "The record would be expired at once.")
    require(expires_at_ms - ctx.time <= RETENTION_MAX_MS, "EXPIRY_WRONG", "A record is kept for a year at most.")
    require(not state.has(b"record/" + record_id), "RECORD_EXISTS", "There is a record of this id.")
    entry = {
        "owner": owner,
        "robot": ctx.caller,
        "commitment_root": commitment_root,
        "ciphertext_root": ciphertext_root,
        "sealed_metadata": sealed_metadata,
        "bucket_ms": bucket_ms,
        "expires_at_ms": expires_at_ms,
        "height": ctx.height,
        "txid": ctx.txid,
        "status": "active",
        "erased_frames": [],
        "awaited": [],
    }
    state.put(b"record/" + record_id, entry)
    state.put(b"of-visit/" + owner + record_id, True)
    call("audit", "append", owner, record_id, "recorded", {})
    data = {
        "record_id": record_id,
        "owner": owner,
        "commitment_root": commitment_root,
        "ciphertext_root": ciphertext_root,
        "expires_at_ms": expires_at_ms,
        "robot": ctx.caller,
    }
    emit("recorded", data)


@export
def close_visit(owner: bytes, record_count: int):
    """Close a visit and say how many records it has. Who may call: the robot that opened it."""
    require_robot()
    opened = require_open_visit(owner)
    require(record_count >= 0 and record_count <= RECORD_COUNT_MAX, "RECORD_COUNT_WRONG", "The count is out of range.")
    opened["status"] = "closed"
    opened["record_count"] = record_count
    state.put(b"visit/" + owner, opened)
    call("audit", "append", owner, b"", "visit_closed", {"record_count": record_count})
    emit("visit_closed", {"owner": owner, "record_count": record_count})


@export
def transfer(owner: bytes, ephemeral: bytes, view_tag: int, new_owner_signature: bytes):
    """Put a new owner key in place of a visit's own, which decides nothing any more.

    Who may call: the visit's owner key, with the new key's agreement. So nobody takes up a key that is another's, or that
    a robot is about to use.

    The new key is announced as a visit is, so that its holder finds it. A denied visit can be transferred too: nothing is
    released by that, and whoever stole its key would have it once the quarantine ends.
    """
    require(ctx.calling_contract == "", "CALL_INDIRECT", "Only a transaction does that, no other contract in its name.")
    check_new_keys(owner, ephemeral, view_tag)
    root = root_of(ctx.caller)
    signer = recover(TRANSFER_TAG, new_owner_signature, ctx.chain + root + owner)
    require(signer == owner, "TRANSFER_SIGNATURE_WRONG", "The new key did not sign that it takes this visit over.")
    require_unused(owner)
    before = state.get(b"current/" + root)
    transfers = 1
    if before is not None:
        transfers = before["transfers"] + 1
    require(transfers <= TRANSFERS_MAX_COUNT, "TRANSFERS_TOO_MANY", "A visit is transferred 64 times at most.")
    opened = state.get(b"visit/" + root)
    sequence = announce([owner, ephemeral, view_tag, opened["bucket_ms"], opened["robot"], root])
    state.put(b"root/" + owner, root)
    state.put(b"current/" + root, {"owner": owner, "transfers": transfers})
    call("audit", "append", root, b"", "transferred", {"transfers": transfers})
    emit("transferred", {"owner": root, "new_owner": owner, "ephemeral": ephemeral, "view_tag": view_tag, "sequence": sequence})


@view
def root_of(key: bytes) -> bytes:
    """Return the first key of the visit that this key decides of now. Fails for a key that was replaced by another."""
    require(len(key) == KEY_BYTES, "KEY_SIZE_WRONG", "O has 33 bytes.")
    root = state.get(b"root/" + key, key)
    require(state.has(b"visit/" + root), "VISIT_UNKNOWN", "There is no visit under this owner key.")
    require(current_of(root) == key, "VISIT_TRANSFERRED", "The visit was transferred: another key decides of it now.")
    return root


@view
def is_owner_key(key: bytes) -> bool:
    """Tell whether a visit has, or had, this owner key."""
    return state.has(b"visit/" + key) or state.has(b"root/" + key)


@view
def current_of(root: bytes) -> bytes:
    """Return the key that decides of the visit with this first key (the first key itself until it is transferred)."""
    current = state.get(b"current/" + root)
    if current is None:
        return root
    return current["owner"]


def organisation_of_robot(robot: bytes) -> str:
    known = None
    if len(robot) == KEY_BYTES:
        known = call("identity", "member", robot)
    require(known is not None and known["role"] == "robot", "ROBOT_UNKNOWN", "There is no such robot.")
    return known["org"]


def speaks_for(key: bytes, org: str) -> bool:
    """Tell whether a key is of an admin or an officer of an organisation."""
    if call("identity", "admin_of", key) == org:
        return True
    return call("identity", "role_of", key) == "officer" and call("identity", "member", key)["org"] == org


def check_empty_frames(frames: list):
    require(ctx.calling_contract == "", "CALL_INDIRECT", "Only a transaction does that, no other contract in its name.")
    bounded = len(frames) > 0 and len(frames) <= EMPTY_FRAMES_A_CALL_MAX_COUNT
    require(bounded, "EMPTY_FRAMES_COUNT_WRONG", "A call names 1 to 32 empty frames.")
    for frame in frames:
        known = isinstance(frame, bytes) and len(frame) == HASH_BYTES
        require(known, "EMPTY_FRAME_WRONG", "An empty frame is named by its SHA-256, 32 bytes.")


@export
def approve_empty_frames(robot: bytes, frames: list):
    """Let a robot publish these pictures, which show nobody. Who may call: an officer or admin of the robot's organisation."""
    check_empty_frames(frames)
    org = organisation_of_robot(robot)
    require(speaks_for(ctx.caller, org), "NOT_OF_THE_ORGANISATION", "Only an officer or admin of the robot's organisation may do that.")
    require(call("identity", "role_of", robot) == "robot", "ROBOT_UNKNOWN", "The robot was revoked.")
    approved = state.get(b"empty-frames/" + robot, [])
    known = [row[0] for row in approved]
    for frame in frames:
        if frame not in known:
            known.append(frame)
            approved.append([frame, ctx.caller, ctx.time])
            state.put(b"empty-frame/" + frame, state.get(b"empty-frame/" + frame, 0) + 1)
    fits = len(approved) <= EMPTY_FRAMES_MAX_COUNT
    require(fits, "EMPTY_FRAMES_TOO_MANY", "A robot has at most 128 approved empty frames: withdraw old ones first.")
    state.put(b"empty-frames/" + robot, approved)
    emit("empty_frames_approved", {"robot": robot, "frames": frames, "approver": ctx.caller})


@export
def withdraw_empty_frames(robot: bytes, frames: list):
    """Take pictures back; every custodian deletes those that are left to no robot.

    Who may call: an officer or admin of the robot's organisation, or an admin of another once that one was removed.
    """
    check_empty_frames(frames)
    org = organisation_of_robot(robot)
    entitled = speaks_for(ctx.caller, org)
    if not entitled and call("identity", "admin_count", org) == 0:
        entitled = call("identity", "admin_of", ctx.caller) != ""
    require(entitled, "NOT_OF_THE_ORGANISATION", "Only an officer or admin of the robot's organisation may do that.")
    approved = state.get(b"empty-frames/" + robot, [])
    known = [row[0] for row in approved]
    gone = []
    for frame in frames:
        require(frame in known, "EMPTY_FRAME_UNKNOWN", "An empty frame is not approved for this robot, or is named twice.")
        known.remove(frame)
        others = state.get(b"empty-frame/" + frame) - 1
        if others > 0:
            state.put(b"empty-frame/" + frame, others)
        else:
            state.delete(b"empty-frame/" + frame)
            gone.append(frame)
    state.put(b"empty-frames/" + robot, [row for row in approved if row[0] in known])
    emit("empty_frames_withdrawn", {"robot": robot, "frames": frames, "gone": gone})


@view
def empty_frames(robot: bytes) -> list:
    """Return [sha256, approver, time] of the empty frames that a robot may publish, the oldest first."""
    return state.get(b"empty-frames/" + robot, [])


def check_ids(record_ids: list):
    require(len(record_ids) > 0, "RECORDS_MISSING", "No record is named.")
    require(len(record_ids) <= RECORDS_A_CALL_MAX_COUNT, "RECORDS_TOO_MANY", "At most 64 records may be named.")
    for record_id in record_ids:
        known = isinstance(record_id, bytes) and len(record_id) == ID_BYTES
        require(known, "RECORD_ID_WRONG", "A record id has 16 bytes.")


def require_own(record_id: bytes, owner: bytes) -> dict:
    entry = state.get(b"record/" + record_id)
    require(entry is not None, "RECORD_UNKNOWN", "There is no such record.")
    require(entry["owner"] == owner, "NOT_THE_OWNER", "The record belongs to another owner key.")
    return entry


@view
def require_records(owner: bytes, record_ids: list, any_status: bool) -> bool:
    """Fail unless the owner has a visit and all these records (at most 64) are its own, and active if asked."""
    require(len(owner) == KEY_BYTES, "KEY_SIZE_WRONG", "O has 33 bytes.")
    require(state.has(b"visit/" + owner), "VISIT_UNKNOWN", "There is no visit under this owner key.")
    require(len(record_ids) <= RECORDS_A_CALL_MAX_COUNT, "RECORDS_TOO_MANY", "At most 64 records may be named.")
    for record_id in record_ids:
        require(isinstance(record_id, bytes) and len(record_id) == ID_BYTES, "RECORD_ID_WRONG", "A record id has 16 bytes.")
        entry = require_own(record_id, owner)
        require(any_status or entry["status"] == "active", "RECORD_ERASED", "The record is erased.")
    return True


def reduce(entry: dict, status: str) -> dict:
    """Take out of a record's state what could still say anything of the pictures."""
    entry["commitment_root"] = b""
    entry["ciphertext_root"] = b""
    entry["sealed_metadata"] = b""
    entry["status"] = status
    return entry


@export
def begin_erasure(owner: bytes, record_ids: list, frames: list):
    """Mark whole records as being erased, or check that frames of one may be. Who may call: the contract `erasure`."""
    require(ctx.calling_contract == "erasure", "NOT_THE_ERASURE_CONTRACT", "Only the contract erasure may do that.")
    check_ids(record_ids)
    for record_id in record_ids:
        entry = require_own(record_id, owner)
        require(entry["status"] == "active", "RECORD_ERASED", "The record is erased, or its erasure is asked for.")
        if len(frames) == 0:
            entry["status"] = "erasing"
            state.put(b"record/" + record_id, entry)
            state.delete(b"of-visit/" + owner + record_id)
        else:
            note_asked(record_id, frames)


def note_asked(record_id: bytes, frames: list):
    """Each request names a frame more, so that a record has no more requests than a clip has frames."""
    asked = state.get(b"asked-frames/" + record_id, [])
    before = len(asked)
    for frame in frames:
        if frame not in asked:
            asked.append(frame)
    require(len(asked) > before, "RECORD_ERASED", "All these frames are erased, or their erasure is asked for.")
    state.put(b"asked-frames/" + record_id, sorted(asked))


@export
def complete_erasure(record_ids: list, frames: list):
    """Reduce erased records, or note the erased frames of one. Who may call: the contract `erasure`."""
    require(ctx.calling_contract == "erasure", "NOT_THE_ERASURE_CONTRACT", "Only the contract erasure may do that.")
    check_ids(record_ids)
    for record_id in record_ids:
        entry = state.get(b"record/" + record_id)
        if len(frames) == 0:
            state.put(b"record/" + record_id, reduce(entry, "erased"))
        elif entry["status"] == "active" or entry["status"] == "erasing":
            erased = entry["erased_frames"]
            for frame in frames:
                if frame not in erased:
                    erased.append(frame)
            entry["erased_frames"] = sorted(erased)
            state.put(b"record/" + record_id, entry)


@export
def expire(record_ids: list, custodian: bytes, custodians: list) -> list:
    """Reduce expired records and note who destroyed them; they are erased once none of `custodians` is awaited.

    Returns the owners of what changed, each once. Who may call: the contract `erasure`.
    """
    require(ctx.calling_contract == "erasure", "NOT_THE_ERASURE_CONTRACT", "Only the contract erasure may do that.")
    check_ids(record_ids)
    entries = []
    for record_id in record_ids:
        entry = state.get(b"record/" + record_id)
        require(entry is not None, "RECORD_UNKNOWN", "There is no such record.")
        require(entry["expires_at_ms"] <= ctx.time, "RECORD_NOT_EXPIRED", "The record has not expired.")
        entries.append(entry)
    expiring = zip(record_ids, entries)
    call("rights", "require_not_held", [[entry["owner"], name, entry["expires_at_ms"]] for name, entry in expiring])
    owners = []
    for record_id, entry in zip(record_ids, entries):
        awaited = entry["awaited"]
        if entry["status"] == "active":
            awaited = custodians
        left = [key for key in awaited if key != custodian and key in custodians]
        waiting = entry["status"] == "active" or entry["status"] == "expired"
        if waiting and len(left) < len(awaited):
            entry["awaited"] = left
            state.put(b"record/" + record_id, reduce(entry, "expired" if len(left) > 0 else "erased"))
            state.delete(b"of-visit/" + entry["owner"] + record_id)
            if entry["owner"] not in owners:
                owners.append(entry["owner"])
    return owners


@view
def visit(owner: bytes) -> dict | None:
    """Return a visit's state, or None."""
    return state.get(b"visit/" + owner)


@view
def get(record_id: bytes) -> dict | None:
    """Return a record's state, or None."""
    return state.get(b"record/" + record_id)


@view
def announcements(first: int, limit: int) -> list:
    """Return at most 256 announcements from number `first` on: [O, R, view tag, bucket, robot], or with the root."""
    count = state.get(b"announcement-count", 0)
    found = []
    for number in range(max(0, first), min(count, first + min(limit, SCAN_MAX_COUNT))):
        found.append(state.get(b"announcement/" + u64(number)))
    return found


@view
def of_visit(owner: bytes) -> list:
    """Return the ids of a visit's active records, sorted. (Up to 256 for each first byte; ids are hashes.)"""
    prefix = b"of-visit/" + owner
    entries = state.scan(prefix, SCAN_MAX_COUNT)
    if len(entries) == SCAN_MAX_COUNT:
        entries = []
        for first in range(256):
            part = state.scan(prefix + first.to_bytes(1), SCAN_PART_COUNT)
            if len(part) == SCAN_PART_COUNT:
                part = state.scan(prefix + first.to_bytes(1), SCAN_MAX_COUNT)
            entries.extend(part)
    ids = []
    for entry in entries:
        ids.append(entry[0][len(prefix):])
    return ids


@view
def require_none_active(owner: bytes) -> bool:
    """Fail if a record of the visit is neither erased, nor being erased, nor reported as expired."""
    left = state.scan(b"of-visit/" + owner, 1)
    require(len(left) == 0, "RECORDS_LEFT", "A record of the visit is still there: have it erased first.")
    return True

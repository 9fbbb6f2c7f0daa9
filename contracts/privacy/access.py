"""Access: an owner asks or shares, custodians release or refuse, the owner judges. Must never let a release stand without a
request, nor name whom records are shared with.

A grantee's key is a one-time key, found by scanning as visits are; who they are stands in a salted hash. Nothing stands
under that key itself: whoever uses it names the grant. So nobody who sees a key on its way can spend it, neither for
another grant nor for a visit. What it keeps: docs/reference/state.md.
"""

KEY_BYTES = 33
RECORD_ID_BYTES = 16
HASH_BYTES = 32
GRANT_RECORDS_MAX_COUNT = 64
GRANT_STEP_MS = 300000
GRANT_MAX_MS = 31622400000
GRANT_NOTICE_MS = 7776000000
GRANTS_OPEN_MAX_COUNT = 64
NOTICES_MAX_COUNT = 256
PAGE_MAX_COUNT = 128
OWN_PURPOSE = "own-access"
ID_BYTES = 32
FRAMES_MAX_COUNT = 64
FINDINGS_MAX_COUNT = 64
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
    note(owner, records, "access_requested", {"access_id": ctx.txid, "records": len(records), "purpose": purpose})
    emit("requested", {"access_id": ctx.txid, "owner": owner, "records": records, "purpose": purpose})


def require_access(access_id: bytes) -> dict:
    require(call("identity", "is_custodian", ctx.caller), "NOT_A_CUSTODIAN", "Only a custodian may do that.")
    require(len(access_id) == ID_BYTES, "ACCESS_UNKNOWN", "An access id has 32 bytes.")
    entry = state.get(b"access/" + access_id)
    require(entry is not None, "ACCESS_UNKNOWN", "There is no such access request.")
    return entry


@export
def released(access_id: bytes, record_ids: list):
    """Say which records (1 to 64, sorted) were handed out. Who may call: a custodian, once for each record.

    Of records that it named before only the others are written: restarted with an old store, it may not know what it
    said already, and neither may a release stand twice nor one be left out.
    """
    entry = require_access(access_id)
    check_named(record_ids)
    require(record_ids == sorted(record_ids), "RECORD_ID_WRONG", "The records are named in order.")
    call("records", "require_records", entry["owner"], record_ids, True)
    prefix = b"release/" + access_id + ctx.caller
    fresh = []
    for record_id in record_ids:
        named = len(entry["records"]) == 0 or record_id in entry["records"]
        require(named, "RECORD_NOT_REQUESTED", "The request does not name this record.")
        if not state.has(prefix + record_id):
            state.put(prefix + record_id, True)
            fresh.append(record_id)
    require(len(fresh) > 0, "RELEASE_EXISTS", "The custodian has said so already.")
    entry["released"][ctx.caller] = entry["released"].get(ctx.caller, 0) + len(fresh)
    state.put(b"access/" + access_id, entry)
    note(entry["owner"], fresh, "access_released", {"access_id": access_id, "custodian": ctx.caller, "records": len(fresh)})
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


def check_finding(finding: list):
    """A finding is [record id, judgement, frames that were changed]."""
    require(isinstance(finding, list) and len(finding) == 3, "FINDING_WRONG", "A finding has an id, a verdict and frames.")
    require(isinstance(finding[1], str) and finding[1] in VERDICTS, "VERDICT_UNKNOWN", "A verdict is verified or corrupted.")
    frames = finding[2]
    require(isinstance(frames, list) and len(frames) <= FRAMES_MAX_COUNT, "FRAMES_WRONG", "A clip has at most 64 frames.")
    for frame in frames:
        require(isinstance(frame, int) and frame >= 0 and frame < FRAMES_MAX_COUNT, "FRAMES_WRONG", "No such frame.")


@export
def verdict(findings: list):
    """Say of 1 to 64 records of a visit whether what was released is what the robot committed to, as one audit entry.

    A finding is [record id, `verified` or `corrupted`, frames that were changed]. Who may call: the visit's owner key.
    """
    require(len(findings) > 0, "RECORDS_MISSING", "No record is named.")
    require(len(findings) <= FINDINGS_MAX_COUNT, "RECORDS_TOO_MANY", "At most 64 records may be named.")
    for finding in findings:
        check_finding(finding)
    named = [finding[0] for finding in findings]
    check_named(named)
    owner = call("records", "root_of", ctx.caller)
    call("records", "require_records", owner, named, True)
    overall = VERDICTS[0]
    for record_id, judgement, frames in findings:
        state.put(b"verdict/" + record_id, {"verdict": judgement, "frames": frames, "time": ctx.time})
        if judgement == VERDICTS[1]:
            overall = judgement
    note(owner, named, "verdict", {"verdict": overall, "findings": findings})
    emit("verdict", {"owner": owner, "verdict": overall, "findings": findings})


def check_named(records: list):
    """The records are 1 to 64, each named once."""
    require(len(records) > 0, "RECORDS_MISSING", "No record is named.")
    require(len(records) <= GRANT_RECORDS_MAX_COUNT, "RECORDS_TOO_MANY", "At most 64 records may be named.")
    seen = {}
    for record_id in records:
        sized = isinstance(record_id, bytes) and len(record_id) == RECORD_ID_BYTES
        require(sized, "RECORD_ID_WRONG", "A record id has 16 bytes.")
        require(record_id not in seen, "RECORD_ID_WRONG", "A record is named twice.")
        seen[record_id] = True


def require_shareable(owner: bytes, records: list, purpose: str):
    """These records of a visit may be seen by somebody else than its owner for this purpose, now."""
    call("records", "require_records", owner, records, False)
    call("rights", "require_release", owner, records, purpose)
    row = call("rights", "restriction", owner)
    if row is not None:
        for record_id in records:
            restricted = row["whole"] or record_id in row["records"]
            require(not restricted, "RECORD_RESTRICTED", "It is restricted: only the owner looks at it.")


def check_grantee(grantee: bytes, ephemeral: bytes, view_tag: int, member_hash: bytes):
    sized = len(grantee) == KEY_BYTES and len(ephemeral) == KEY_BYTES
    require(sized, "KEY_SIZE_WRONG", "G and R have 33 bytes each.")
    require(view_tag >= 0 and view_tag < 256, "VIEW_TAG_WRONG", "A view tag is one byte.")
    require(len(member_hash) == HASH_BYTES, "MEMBER_HASH_WRONG", "A hash has 32 bytes.")
    member = call("identity", "member", grantee)
    require(member is None, "GRANTEE_WRONG", "G is a fresh one-time key, never a member's.")


def open_grants(owner: bytes) -> dict:
    """The grants of a visit that stand: id and end of each."""
    found = {}
    for grant_id, until_ms in state.get(b"open-grants/" + owner, {}).items():
        if until_ms > ctx.time:
            found[grant_id] = until_ms
    return found


@export
def grant(
    records: list, grantee: bytes, ephemeral: bytes, view_tag: int, member_hash: bytes, purpose: str, until_ms: int
):
    """Share 1 to 64 records with one member for a purpose, until a time. Who may call: the visit's owner key.

    What is restricted, denied or objected to is not shared. `until_ms` is on five full minutes, 366 days ahead at most;
    64 grants of a visit stand at once.
    """
    require(ctx.calling_contract == "", "CALL_INDIRECT", "Only a transaction does that, no other contract in its name.")
    check_named(records)
    check_grantee(grantee, ephemeral, view_tag, member_hash)
    require(call("identity", "purpose_known", purpose), "PURPOSE_UNKNOWN", "The purpose is not published.")
    require(purpose != OWN_PURPOSE, "PURPOSE_OWN", "The owner's own access is nobody else's purpose.")
    in_range = until_ms > ctx.time and until_ms <= ctx.time + GRANT_MAX_MS
    require(in_range and until_ms % GRANT_STEP_MS == 0, "UNTIL_WRONG", "A grant ends on five full minutes, in 366 days at most.")
    owner = call("records", "root_of", ctx.caller)
    require_shareable(owner, records, purpose)
    standing = open_grants(owner)
    require(len(standing) < GRANTS_OPEN_MAX_COUNT, "GRANTS_TOO_MANY", "64 grants of the visit stand: revoke one first.")
    standing[ctx.txid] = until_ms
    state.put(b"open-grants/" + owner, standing)
    number = state.get(b"grant-count", 0)
    entry = {
        "owner": owner,
        "records": records,
        "grantee": grantee,
        "ephemeral": ephemeral,
        "view_tag": view_tag,
        "member_hash": member_hash,
        "purpose": purpose,
        "until_ms": until_ms,
        "ended_ms": until_ms,
        "time": ctx.time,
        "height": ctx.height,
        "status": "active",
        "noticed": [],
        "notices": 0,
    }
    state.put(b"grant-count", number + 1)
    state.put(b"grant-number/" + u64(number), ctx.txid)
    state.put(b"grant/" + ctx.txid, entry)
    data = {"grant_id": ctx.txid, "records": len(records), "purpose": purpose, "until_ms": until_ms}
    note(owner, records, "granted", data)
    emit("granted", {"grant_id": ctx.txid, "owner": owner, "records": records, "until_ms": until_ms})


def note(owner: bytes, records: list, kind: str, data: dict):
    subject = b""
    if len(records) == 1:
        subject = records[0]
    call("audit", "append", owner, subject, kind, data)


def require_grant(grant_id: bytes) -> dict:
    require(ctx.calling_contract == "", "CALL_INDIRECT", "Only a transaction does that, no other contract in its name.")
    require(len(grant_id) == ID_BYTES, "GRANT_UNKNOWN", "A grant's id has 32 bytes.")
    entry = state.get(b"grant/" + grant_id)
    require(entry is not None, "GRANT_UNKNOWN", "There is no such grant.")
    return entry


def has_ended(entry: dict) -> bool:
    return entry["status"] != "active" or entry["until_ms"] <= ctx.time


@export
def revoke(grant_id: bytes):
    """End a grant at once: custodians destroy what they hold of its keys. Who may call: the visit's owner key."""
    entry = require_grant(grant_id)
    owner = call("records", "root_of", ctx.caller)
    require(entry["owner"] == owner, "NOT_THE_OWNER", "The grant is another visit's.")
    require(not has_ended(entry), "GRANT_ENDED", "The grant was revoked before, or its time is over.")
    entry["status"] = "revoked"
    entry["ended_ms"] = ctx.time
    state.put(b"grant/" + grant_id, entry)
    standing = open_grants(owner)
    del standing[grant_id]
    state.put(b"open-grants/" + owner, standing)
    note(owner, entry["records"], "grant_revoked", {"grant_id": grant_id})
    emit("revoked", {"grant_id": grant_id, "owner": owner})


@export
def request_granted(grant_id: bytes, records: list, purpose: str):
    """Ask for 1 to 64 records that were shared, for the purpose of the grant. Who may call: the grantee's key of the grant.

    64 times a day (UTC). What was restricted, denied or erased meanwhile is refused.
    """
    entry = require_grant(grant_id)
    require(entry["grantee"] == ctx.caller, "NOT_THE_GRANTEE", "The grant is for another key.")
    require(not has_ended(entry), "GRANT_ENDED", "The grant was revoked, or its time is over.")
    check_named(records)
    for record_id in records:
        require(record_id in entry["records"], "RECORD_NOT_GRANTED", "The grant does not name this record.")
    require(purpose == entry["purpose"], "PURPOSE_OTHER", "The records were shared for another purpose.")
    require_shareable(entry["owner"], records, purpose)
    asked = {
        "owner": entry["owner"],
        "records": records,
        "purpose": purpose,
        "time": ctx.time,
        "released": {},
        "refused": {},
        "grant": grant_id,
    }
    state.put(b"access/" + ctx.txid, asked)
    data = {"access_id": ctx.txid, "records": len(records), "purpose": purpose, "grant": grant_id}
    note(entry["owner"], records, "access_requested", data)
    told = {"access_id": ctx.txid, "owner": entry["owner"], "records": records, "purpose": purpose, "grant": grant_id}
    emit("requested", told)


@export
def noticed(grant_id: bytes, record_ids: list):
    """Say that one was told what became of shared records, and keeps no copy of what is gone.

    It counts for 90 days after the end of the grant too. Who may call: the grantee's key of the grant.
    """
    entry = require_grant(grant_id)
    require(entry["grantee"] == ctx.caller, "NOT_THE_GRANTEE", "The grant is for another key.")
    check_named(record_ids)
    require(ctx.time < entry["ended_ms"] + GRANT_NOTICE_MS, "GRANT_ENDED", "The grant ended more than 90 days ago.")
    require(entry["notices"] < NOTICES_MAX_COUNT, "NOTICES_TOO_MANY", "A grant takes 256 notices.")
    gone = []
    for record_id in record_ids:
        require(record_id in entry["records"], "RECORD_NOT_GRANTED", "The grant does not name this record.")
        if has_ended(entry) or call("records", "get", record_id)["status"] != "active":
            gone.append(record_id)
    fresh = [record_id for record_id in gone if record_id not in entry["noticed"]]
    said = len(gone) == len(record_ids) and len(fresh) == 0
    require(not said, "NOTICE_EXISTS", "It was said of all these records before.")
    entry["noticed"] = entry["noticed"] + fresh
    entry["notices"] += 1
    state.put(b"grant/" + grant_id, entry)
    note(entry["owner"], record_ids, "grant_noticed", {"grant_id": grant_id, "records": record_ids})
    emit("noticed", {"grant_id": grant_id, "owner": entry["owner"], "records": record_ids})


@view
def grant_of(grant_id: bytes) -> dict | None:
    """Return a grant's state, or None."""
    return state.get(b"grant/" + grant_id)


@view
def grants(first: int, limit: int) -> list:
    """Return the ids of at most 128 grants from number `first` on, in order."""
    count = state.get(b"grant-count", 0)
    found = []
    for number in range(max(0, first), min(count, first + min(limit, PAGE_MAX_COUNT))):
        found.append(state.get(b"grant-number/" + u64(number)))
    return found


@view
def get(access_id: bytes) -> dict | None:
    """Return an access request's state, or None."""
    return state.get(b"access/" + access_id)


@view
def verdict_of(record_id: bytes) -> dict | None:
    """Return the last verdict on a record, or None."""
    return state.get(b"verdict/" + record_id)

"""Rights of the recorded person, and what data protection officers do of them. Must never name a member beside a visit.

What a person says of a visit is signed with the visit's owner key; only an objection to being recorded at all, which is
about no visit, with their member key. A restriction is lifted by nobody else, and a quarantine by an officer alone. What it keeps: docs/reference/state.md.
"""

KEY_BYTES = 33
ID_BYTES = 16
HASH_BYTES = 32
GROUNDS = ("accuracy", "legal-claim", "objection", "unlawful")
KEEPING_GROUNDS = ("legal-claim", "unlawful")
KEEP_MS = 31622400000
OWN_PURPOSES = ("complaint", "own-access")
CORRECTIONS = ("attribution", "metadata")
RISKS = ("high", "none", "risk")
RECIPIENTS = ("authority", "subjects")
OUTCOMES = ("erased", "released")
REASONS = (
    "facts-came-late",
    "matched-wrongly",
    "nothing-released",
    "officer-unreachable",
    "owner-confirmed",
    "released-before",
    "tag-of-another",
)
DELAY_REASONS = ("facts-came-late", "officer-unreachable")
NOTIFY_MS = 259200000
RECORDS_MAX_COUNT = 64
PURPOSES_MAX_COUNT = 16
CORRECTIONS_MAX_COUNT = 256
PAGE_MAX_COUNT = 128


def require_direct():
    require(ctx.calling_contract == "", "CALL_INDIRECT", "Only a transaction does that, no other contract in its name.")


def require_owner(records: list) -> bytes:
    """Return the root of the visit that the caller decides of; it is not quarantined, and these records are its own."""
    require_direct()
    require(len(records) <= RECORDS_MAX_COUNT, "RECORDS_TOO_MANY", "At most 64 records may be named.")
    owner = call("records", "root_of", ctx.caller)
    call("records", "require_records", owner, records, True)
    require_open(owner)
    return owner


def note(owner: bytes, records: list, kind: str, data: dict):
    subject = b""
    if len(records) == 1:
        subject = records[0]
    call("audit", "append", owner, subject, kind, data)


def held_in(row: dict | None, record_id: bytes, expires_at_ms: int) -> int:
    """Return until when a restriction keeps a record that would expire, in ms; 0 if it does not."""
    if row is None:
        return 0
    if record_id in row["records"] or (row["whole"] and row["whole_since_ms"] < expires_at_ms):
        return row["until_ms"]
    return 0


def is_there(row: dict | None, record_id: bytes) -> bool:
    """Tell whether a record is neither erased nor past the time for which it is kept."""
    entry = call("records", "get", record_id)
    if entry["status"] != "active":
        return False
    return max(entry["expires_at_ms"], held_in(row, record_id, entry["expires_at_ms"])) > ctx.time


@export
def restrict(records: list, ground: str):
    """Restrict 1 to 64 records, or (none named) the whole visit and what is still to come of it (Art. 18).

    Only the owner sees them from then on. On the grounds `legal-claim` and `unlawful` they are also kept beyond their expiry,
    for 366 days at a time. Who may call: the visit's owner key.
    """
    owner = require_owner(records)
    require(ground in GROUNDS, "GROUND_UNKNOWN", "There is no such ground.")
    before = state.get(b"restriction/" + owner)
    kept = before is not None and before["until_ms"] > ctx.time
    keeps = ground in KEEPING_GROUNDS
    require(keeps or not kept, "RESTRICTION_STANDS", "A restriction that keeps records stands: lift it first.")
    named = []
    if before is not None:
        named = [known for known in before["records"] if kept or not keeps or is_there(before, known)]
    for record_id in records:
        require(is_there(before, record_id), "RECORD_ERASED", "The record is erased, or has expired.")
        if record_id not in named:
            named.append(record_id)
    require(len(named) <= RECORDS_MAX_COUNT, "RECORDS_TOO_MANY", "Restrict the whole visit: name no record.")
    was_whole = before is not None and before["whole"]
    since = ctx.time
    if was_whole and (kept or not keeps):
        since = before["whole_since_ms"]
    row = {
        "ground": ground,
        "whole": was_whole or len(records) == 0,
        "whole_since_ms": since,
        "until_ms": ctx.time + KEEP_MS if keeps else 0,
        "records": named,
        "time": ctx.time,
    }
    state.put(b"restriction/" + owner, row)
    note(owner, records, "restricted", {"ground": ground, "records": len(records), "until_ms": row["until_ms"]})
    tell_restriction("restricted", owner, row)


def tell_restriction(name: str, owner: bytes, row: dict):
    """Custodians hear all that is restricted of the visit now, not what changed."""
    told = {
        "owner": owner,
        "whole": row["whole"],
        "whole_since_ms": row["whole_since_ms"],
        "until_ms": row["until_ms"],
        "records": row["records"],
    }
    emit(name, told)


@export
def lift(records: list):
    """Lift the restriction of named records, or (none named) everything. Who may call: the visit's owner key."""
    owner = require_owner(records)
    row = state.get(b"restriction/" + owner)
    require(row is not None, "NOT_RESTRICTED", "Nothing of this visit is restricted.")
    if len(records) > 0:
        require(not row["whole"], "RESTRICTED_WHOLE", "The whole visit is restricted: lift that, naming no record.")
        for record_id in records:
            require(record_id in row["records"], "NOT_RESTRICTED", "The record is not restricted.")
    row["records"] = [known for known in row["records"] if len(records) > 0 and known not in records]
    row["whole"] = False
    if len(row["records"]) > 0:
        state.put(b"restriction/" + owner, row)
    else:
        row["until_ms"] = 0
        state.delete(b"restriction/" + owner)
    note(owner, records, "restriction_lifted", {"records": len(records)})
    tell_restriction("lifted", owner, row)


def check_purposes(purposes: list):
    named = 0 < len(purposes) and len(purposes) <= PURPOSES_MAX_COUNT
    require(named, "CHOICE_MISSING", "An objection names 1 to 16 purposes.")
    for code in purposes:
        known = isinstance(code, str) and call("identity", "purpose_known", code)
        require(known, "PURPOSE_UNKNOWN", "The purpose is not published.")
        require(code not in OWN_PURPOSES, "PURPOSE_OWN", "Nobody can be kept from their own records, or from a complaint.")


@export
def object_to(handle: bytes, purposes: list):
    """Object to being recorded for purposes, by whatever sensor (Art. 21).

    It counts as a no in the contract `consent`, from the next block on, whatever the recording was based on.
    Who may call: the person of the handle, or who acts for them by a mandate.
    """
    require_direct()
    check_purposes(purposes)
    call("consent", "objected", handle, purposes)


@export
def object_to_release(purposes: list):
    """Object to any release of a visit for purposes (Art. 21). Who may call: the visit's owner key."""
    owner = require_owner([])
    check_purposes(purposes)
    row = state.get(b"objection/" + owner, {})
    for code in purposes:
        if code not in row:
            row[code] = ctx.time
    require(len(row) <= PURPOSES_MAX_COUNT, "PURPOSES_TOO_MANY", "At most 16 purposes may be named.")
    state.put(b"objection/" + owner, row)
    note(owner, [], "objected", {"purposes": purposes})
    emit("objected", {"owner": owner, "purposes": purposes})


@export
def rectify(records: list, kind: str, commitment: bytes):
    """Append a correction, of which the chain holds a salted hash; nothing is changed (Art. 16).

    Each names the one before. Who may call: the visit's owner key.
    """
    owner = require_owner(records)
    require(kind in CORRECTIONS, "CORRECTION_UNKNOWN", "A correction is of the attribution or of metadata.")
    require(len(commitment) == HASH_BYTES, "COMMITMENT_WRONG", "A commitment has 32 bytes.")
    number = state.get(b"correction-count/" + owner, 0)
    require(number < CORRECTIONS_MAX_COUNT, "CORRECTIONS_TOO_MANY", "A visit takes 256 corrections.")
    previous = b""
    if number > 0:
        previous = state.get(b"correction/" + owner + u32(number - 1))["txid"]
    entry = {
        "records": records,
        "kind": kind,
        "commitment": commitment,
        "previous": previous,
        "txid": ctx.txid,
        "time": ctx.time,
        "height": ctx.height,
    }
    state.put(b"correction/" + owner + u32(number), entry)
    state.put(b"correction-count/" + owner, number + 1)
    note(owner, records, "corrected", {"number": number, "kind": kind, "commitment": commitment})
    emit("corrected", {"owner": owner, "number": number, "kind": kind})


@export
def wrong_person():
    """Say that the visit shows somebody else: quarantine it, and open a breach (Art. 33). Who may call: its owner key.

    The clock of 72 hours begins with this block. Who denies a visit gives up its restriction with it.
    """
    owner = require_owner([])
    robot = call("records", "visit", owner)["robot"]
    org = call("identity", "member", robot)["org"]
    number = state.get(b"breach-count", 0)
    entry = {
        "number": number,
        "owner": owner,
        "robot": robot,
        "org": org,
        "kind": "wrong-person",
        "status": "opened",
        "risk": "",
        "opened_ms": ctx.time,
        "due_ms": ctx.time + NOTIFY_MS,
        "assessed": None,
        "notified": {},
        "closed": None,
    }
    state.put(b"breach-count", number + 1)
    state.put(b"breach-number/" + u64(number), ctx.txid)
    state.put(b"breach/" + ctx.txid, entry)
    state.put(b"quarantine/" + owner, ctx.txid)
    state.delete(b"restriction/" + owner)
    note(owner, [], "denied", {"breach_id": ctx.txid, "due_ms": entry["due_ms"]})
    told = {"breach_id": ctx.txid, "owner": owner, "org": org, "due_ms": entry["due_ms"], "number": number}
    emit("quarantined", told)


def require_officer(breach_id: bytes) -> dict:
    """Return a breach, if the caller is an officer of the organisation whose robot it was."""
    require_direct()
    require(len(breach_id) == HASH_BYTES, "BREACH_UNKNOWN", "A breach's id has 32 bytes.")
    entry = state.get(b"breach/" + breach_id)
    require(entry is not None, "BREACH_UNKNOWN", "There is no such breach.")
    entitled = call("identity", "role_of", ctx.caller) == "officer"
    if entitled:
        entitled = call("identity", "member", ctx.caller)["org"] == entry["org"]
    require(entitled, "NOT_AN_OFFICER", "Only a data protection officer of the robot's organisation may do that.")
    return entry


def require_handling(breach_id: bytes) -> dict:
    entry = require_officer(breach_id)
    require(entry["status"] != "closed", "BREACH_CLOSED", "The breach is closed.")
    return entry


def keep_step(breach_id: bytes, entry: dict, kind: str, data: dict):
    state.put(b"breach/" + breach_id, entry)
    data["breach_id"] = breach_id
    data["officer"] = ctx.caller
    note(entry["owner"], [], kind, data)
    emit(kind, data)


def check_reason(reason: str):
    require(reason in REASONS, "REASON_UNKNOWN", "The reason is not on the published list.")


@export
def assess(breach_id: bytes, risk: str, reason: str):
    """Say how much risk there is for people, and why; said anew it never gets less, lest somebody be told no more.

    Who may call: the organisation's officers.
    """
    entry = require_handling(breach_id)
    require(risk in RISKS, "RISK_UNKNOWN", "A risk is none, risk or high.")
    lowered = (entry["risk"] == "high" and risk != "high") or (entry["risk"] == "risk" and risk == "none")
    require(not lowered, "RISK_LOWERED", "A risk that was said is not lowered: tell those whom it concerns.")
    check_reason(reason)
    entry["risk"] = risk
    entry["assessed"] = {"time": ctx.time, "officer": ctx.caller, "reason": reason}
    if entry["status"] == "opened":
        entry["status"] = "assessed"
    keep_step(breach_id, entry, "breach_assessed", {"risk": risk, "reason": reason})


@export
def notify(breach_id: bytes, recipient: str, reason: str):
    """Say that the authority (Art. 33) or the subjects (Art. 34) were told; after 72 hours with the reason of the delay.

    Who may call: the organisation's officers.
    """
    entry = require_handling(breach_id)
    require(entry["assessed"] is not None, "BREACH_NOT_ASSESSED", "The breach is assessed first.")
    require(recipient in RECIPIENTS, "RECIPIENT_UNKNOWN", "Told are the authority or the subjects.")
    require(recipient not in entry["notified"], "NOTIFIED_ALREADY", "They were told already.")
    late = recipient == "authority" and ctx.time > entry["due_ms"]
    if late:
        require(reason in DELAY_REASONS, "DELAY_UNEXPLAINED", "After 72 hours the reason of the delay is named.")
    elif reason != "":
        check_reason(reason)
    entry["notified"][recipient] = {"time": ctx.time, "officer": ctx.caller, "reason": reason, "late": late}
    entry["status"] = "notified"
    keep_step(breach_id, entry, "breach_notified", {"recipient": recipient, "reason": reason, "late": late})


@export
def order_erasure(breach_id: bytes, records: list):
    """Have records of a denied visit erased, also what came after the breach was closed as `erased`; not as `released`.

    Who may call: the organisation's officers.
    """
    entry = require_officer(breach_id)
    ended = entry["closed"] is not None and entry["closed"]["outcome"] != "erased"
    require(not ended, "BREACH_CLOSED", "The breach is closed.")
    require(entry["assessed"] is not None, "BREACH_NOT_ASSESSED", "The breach is assessed first.")
    call("erasure", "order", entry["owner"], records)


@export
def close(breach_id: bytes, outcome: str, reason: str):
    """End a breach: `released` ends the quarantine, `erased` leaves it in force for ever. Whom it concerns was told first.

    As `erased` it ends once the erasure of every record was asked for. Who may call: the organisation's officers.
    """
    entry = require_handling(breach_id)
    require(entry["assessed"] is not None, "BREACH_NOT_ASSESSED", "The breach is assessed first.")
    require(outcome in OUTCOMES, "OUTCOME_UNKNOWN", "A breach ends as erased or released.")
    check_reason(reason)
    told = entry["risk"] == "none" or "authority" in entry["notified"]
    require(told, "BREACH_NOT_NOTIFIED", "Where there is a risk, the authority is told before.")
    told = entry["risk"] != "high" or "subjects" in entry["notified"]
    require(told, "BREACH_NOT_NOTIFIED", "Where the risk is high, the subjects are told before.")
    if outcome == "erased":
        call("records", "require_none_active", entry["owner"])
    entry["status"] = "closed"
    entry["closed"] = {"time": ctx.time, "officer": ctx.caller, "outcome": outcome, "reason": reason}
    keep_step(breach_id, entry, "breach_closed", {"outcome": outcome, "reason": reason})
    if outcome == "released":
        state.delete(b"quarantine/" + entry["owner"])
        emit("quarantine_ended", {"breach_id": breach_id, "owner": entry["owner"]})


@view
def require_open(owner: bytes) -> bool:
    """Fail if the visit is quarantined: its owner has said that it is not theirs, and decides nothing about it."""
    require(not state.has(b"quarantine/" + owner), "VISIT_QUARANTINED", "The visit was denied, and is quarantined.")
    return True


@view
def require_release(owner: bytes, records: list, purpose: str) -> bool:
    """Fail unless records of a visit (none named: all) may be released to its owner for a purpose."""
    require_open(owner)
    objected = purpose in state.get(b"objection/" + owner, {})
    require(not objected, "PURPOSE_OBJECTED", "The person objected to this purpose.")
    row = state.get(b"restriction/" + owner)
    if row is not None and purpose not in OWN_PURPOSES:
        restricted = row["whole"] or len(records) == 0
        for record_id in records:
            if record_id in row["records"]:
                restricted = True
        require(not restricted, "RECORD_RESTRICTED", "It is restricted: only the owner looks at it.")
    return True


@view
def require_erasable(owner: bytes, records: list) -> bool:
    """Fail if somebody else than the owner must not erase these: the visit is denied, or the owner restricted some of them."""
    require_open(owner)
    row = state.get(b"restriction/" + owner)
    if row is not None:
        restricted = row["whole"]
        for record_id in records:
            if record_id in row["records"]:
                restricted = True
        require(not restricted, "RECORD_RESTRICTED", "Its owner restricted it: nobody else has it erased.")
    return True


@view
def require_not_held(rows: list) -> bool:
    """Fail if a restriction keeps any of these records beyond its expiry: [[owner, record id, expires_at_ms]]."""
    restrictions = {}
    for owner, record_id, expires_at_ms in rows:
        if owner not in restrictions:
            restrictions[owner] = state.get(b"restriction/" + owner)
        held = held_in(restrictions[owner], record_id, expires_at_ms) > ctx.time
        require(not held, "RECORD_RESTRICTED", "A restriction keeps the record.")
    return True


@view
def restriction(owner: bytes) -> dict | None:
    """Return what is restricted of a visit, or None."""
    return state.get(b"restriction/" + owner)


@view
def objections(owner: bytes) -> dict:
    """Return {purpose: since_ms} of a visit."""
    return state.get(b"objection/" + owner, {})


@view
def corrections(owner: bytes, first: int, limit: int) -> list:
    """Return at most 128 corrections of a visit from number `first` on, in order."""
    count = state.get(b"correction-count/" + owner, 0)
    found = []
    for number in range(max(0, first), min(count, first + min(limit, PAGE_MAX_COUNT))):
        found.append(state.get(b"correction/" + owner + u32(number)))
    return found


@view
def breach(breach_id: bytes) -> dict | None:
    """Return a breach's state, or None."""
    return state.get(b"breach/" + breach_id)


@view
def breaches(first: int, limit: int) -> list:
    """Return the ids of at most 128 breaches from number `first` on, in order."""
    count = state.get(b"breach-count", 0)
    found = []
    for number in range(max(0, first), min(count, first + min(limit, PAGE_MAX_COUNT))):
        found.append(state.get(b"breach-number/" + u64(number)))
    return found

"""What two data protection officers do together where a person's key is lost for good: erase by robot and span of time.

Must never act on the word of one person alone. The chain cannot say whose visits those are: others of that robot and
that span may go with them, so the span is short, the number of visits is bounded, and each visit's audit says who did it.
What it keeps: docs/reference/state.md.
"""

KEY_BYTES = 33
ID_BYTES = 32
BUCKET_MS = 300000
SPAN_MAX_MS = 3600000
VISITS_MAX_COUNT = 64
APPROVE_MS = 259200000
CARRY_OUT_MS = 604800000
REASONS = ("authority-order", "guardian-request", "key-lost", "owner-died")
PROPOSALS_A_DAY_MAX_COUNT = 64
DAY_MS = 86400000
PAGE_MAX_COUNT = 128


def require_officer(org: str):
    require(ctx.calling_contract == "", "CALL_INDIRECT", "Only a transaction does that, no other contract in its name.")
    require(is_officer(ctx.caller, org), "NOT_AN_OFFICER", "Only an officer of the robot's organisation may do that.")


def is_officer(key: bytes, org: str) -> bool:
    return call("identity", "role_of", key) == "officer" and call("identity", "member", key)["org"] == org


def handle_of(key: bytes) -> bytes:
    """A person is one handle, whatever keys they have had."""
    return call("identity", "member", key)["handle"]


def is_still_officer(key: bytes, org: str) -> bool:
    """Tell whether the person who once used this key is an officer today."""
    return is_officer(call("identity", "member_of_handle", handle_of(key))["member"], org)


def require_proposal(proposal_id: bytes) -> dict:
    """Return a proposal, if the caller is an officer of its organisation."""
    require(len(proposal_id) == ID_BYTES, "PROPOSAL_UNKNOWN", "A proposal's id has 32 bytes.")
    entry = state.get(b"proposal/" + proposal_id)
    require(entry is not None, "PROPOSAL_UNKNOWN", "There is no such proposal.")
    require_officer(entry["org"])
    return entry


def count_proposal(handle: bytes):
    """Count one more of an officer's proposals of today (UTC)."""
    today = ctx.time // DAY_MS
    day, count = state.get(b"day/" + handle, [today, 0])
    if day != today:
        count = 0
    require(count < PROPOSALS_A_DAY_MAX_COUNT, "WORDS_TOO_MANY", "An officer proposes 64 times a day.")
    state.put(b"day/" + handle, [today, count + 1])


@export
def propose(robot: bytes, from_ms: int, until_ms: int, reason: str, visits_max: int):
    """Propose to erase the visits that a robot opened in a span of 5 to 60 minutes that is over.

    At most `visits_max` of them, for a reason of the published list. Who may call: an officer of the robot's organisation.
    """
    known = None
    if len(robot) == KEY_BYTES:
        known = call("identity", "member", robot)
    require(known is not None and known["role"] == "robot", "ROBOT_UNKNOWN", "There is no such robot.")
    require_officer(known["org"])
    buckets = from_ms >= 0 and from_ms % BUCKET_MS == 0 and until_ms % BUCKET_MS == 0
    require(buckets, "SPAN_WRONG", "A span begins and ends on five full minutes.")
    span = until_ms - from_ms
    require(span > 0 and span <= SPAN_MAX_MS, "SPAN_WRONG", "A span has 5 to 60 minutes: others' visits go with it.")
    require(until_ms <= ctx.time, "SPAN_WRONG", "The span is not over yet: nobody may lose what is still to come.")
    require(reason in REASONS, "REASON_UNKNOWN", "The reason is not on the published list.")
    bounded = visits_max > 0 and visits_max <= VISITS_MAX_COUNT
    require(bounded, "VISITS_WRONG", "Name how many visits it is at most: 1 to 64.")
    count_proposal(handle_of(ctx.caller))
    number = state.get(b"proposal-count", 0)
    entry = {
        "number": number,
        "robot": robot,
        "org": known["org"],
        "from_ms": from_ms,
        "until_ms": until_ms,
        "reason": reason,
        "visits_max": visits_max,
        "visits": 0,
        "records": 0,
        "status": "proposed",
        "proposer": ctx.caller,
        "approver": b"",
        "proposed_ms": ctx.time,
        "approved_ms": 0,
        "ends_ms": ctx.time + APPROVE_MS,
    }
    state.put(b"proposal-count", number + 1)
    state.put(b"proposal-number/" + u64(number), ctx.txid)
    state.put(b"proposal/" + ctx.txid, entry)
    told = {"proposal_id": ctx.txid, "robot": robot, "org": known["org"], "from_ms": from_ms, "until_ms": until_ms}
    told.update({"reason": reason, "visits_max": visits_max, "number": number, "ends_ms": entry["ends_ms"]})
    emit("proposed", told)


@export
def approve(proposal_id: bytes):
    """Agree to a proposal within three days; it can then be carried out for seven.

    Who may call: another officer of the robot's organisation.
    """
    entry = require_proposal(proposal_id)
    require(entry["status"] == "proposed", "PROPOSAL_DECIDED", "The proposal was approved or stopped already.")
    require(ctx.time <= entry["ends_ms"], "PROPOSAL_LAPSED", "Nobody approved it within three days: propose it again.")
    other = handle_of(ctx.caller) != handle_of(entry["proposer"])
    require(other, "OFFICER_THE_SAME", "Who proposed it cannot approve it: that takes a second officer.")
    require_both([entry["proposer"]], entry["org"])
    entry["status"] = "approved"
    entry["approver"] = ctx.caller
    entry["approved_ms"] = ctx.time
    entry["ends_ms"] = ctx.time + CARRY_OUT_MS
    state.put(b"proposal/" + proposal_id, entry)
    emit("approved", {"proposal_id": proposal_id, "officer": ctx.caller, "ends_ms": entry["ends_ms"]})


def require_both(keys: list, org: str):
    for key in keys:
        require(is_still_officer(key, org), "OFFICER_GONE", "One of the two is no officer any more: propose it again.")


@export
def erase(proposal_id: bytes, owner: bytes, records: list):
    """Have 1 to 64 records of one visit erased: one that this robot opened in this span.

    What its owner restricted stays, and so does a visit that was denied. Who may call: either of the two officers.
    """
    entry = require_proposal(proposal_id)
    require(entry["status"] == "approved", "NOT_APPROVED", "No second officer has approved it, or it was stopped.")
    require(ctx.time <= entry["ends_ms"], "PROPOSAL_LAPSED", "It is more than seven days old: propose it again.")
    both = [entry["proposer"], entry["approver"]]
    own = handle_of(ctx.caller) in [handle_of(key) for key in both]
    require(own, "NOT_OF_THE_TWO", "Only one of the two officers who decided it may carry it out.")
    require_both(both, entry["org"])
    visit = None
    if len(owner) == KEY_BYTES:
        visit = call("records", "visit", owner)
    require(visit is not None, "VISIT_UNKNOWN", "There is no visit under this owner key.")
    require(visit["robot"] == entry["robot"], "VISIT_ELSEWHERE", "Another robot opened this visit.")
    within = entry["from_ms"] <= visit["bucket_ms"] and visit["bucket_ms"] < entry["until_ms"]
    require(within, "VISIT_ELSEWHERE", "The visit was not opened in this span.")
    call("rights", "require_erasable", owner, records)
    if not state.has(b"touched/" + proposal_id + owner):
        require(entry["visits"] < entry["visits_max"], "VISITS_TOO_MANY", "That is one visit more than was approved.")
        state.put(b"touched/" + proposal_id + owner, True)
        entry["visits"] += 1
    entry["records"] += len(records)
    state.put(b"proposal/" + proposal_id, entry)
    subject = b""
    if len(records) == 1:
        subject = records[0]
    data = {"proposal_id": proposal_id, "reason": entry["reason"], "officers": both, "records": len(records)}
    call("audit", "append", owner, subject, "erased_by_officers", data)
    call("erasure", "order", owner, records)
    emit("ordered", {"proposal_id": proposal_id, "owner": owner, "records": len(records), "officer": ctx.caller})


@export
def stop(proposal_id: bytes):
    """End a proposal, approved or not; what was ordered under it stays ordered. Who may call: the organisation's officers."""
    entry = require_proposal(proposal_id)
    require(entry["status"] != "stopped", "PROPOSAL_DECIDED", "The proposal was stopped already.")
    entry["status"] = "stopped"
    state.put(b"proposal/" + proposal_id, entry)
    emit("stopped", {"proposal_id": proposal_id, "officer": ctx.caller})


@view
def proposal(proposal_id: bytes) -> dict | None:
    """Return a proposal's state, or None."""
    return state.get(b"proposal/" + proposal_id)


@view
def proposals(first: int, limit: int) -> list:
    """Return the ids of at most 128 proposals from number `first` on, in order."""
    count = state.get(b"proposal-count", 0)
    found = []
    for number in range(max(0, first), min(count, first + min(limit, PAGE_MAX_COUNT))):
        found.append(state.get(b"proposal-number/" + u64(number)))
    return found

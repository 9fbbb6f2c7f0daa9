"""Who acts for a person that cannot, such as a child: a mandate by two officers, on a guardian's papers.

Must never let anybody act outside a mandate's time, its acts and its two persons, nor represent against the own will.
Persons are handles, whatever keys they have had. The papers stay off the chain, and so does the reason: it would be a
word about somebody's health, for ever. The chain has a salted hash of both. What it keeps: docs/reference/state.md.
"""

HANDLE_BYTES = 32
ID_BYTES = 32
PAPERS_BYTES = 32
ACTS = ("consent",)
REPRESENTATIVE_ROLES = ("officer", "staff", "subject")
UNTIL_STEP_MS = 300000
LASTS_MAX_MS = 31622400000
APPROVE_MS = 259200000
ACCEPT_MS = 604800000
PROPOSALS_A_DAY_MAX_COUNT = 64
ACTS_A_DAY_MAX_COUNT = 64
DAY_MS = 86400000
PAGE_MAX_COUNT = 128
PROPOSED = "proposed"
APPROVED = "approved"
ACTIVE = "active"
ENDED = "ended"
GIVEN = "given"


def require_direct():
    require(ctx.calling_contract == "", "CALL_INDIRECT", "Only a transaction does that, no other contract in its name.")


def is_officer(key: bytes, org: str) -> bool:
    return call("identity", "role_of", key) == "officer" and call("identity", "member", key)["org"] == org


def require_officer(org: str):
    require(is_officer(ctx.caller, org), "NOT_AN_OFFICER", "Only an officer of the person's organisation may do that.")


def handle_of(key: bytes) -> bytes:
    return call("identity", "member", key)["handle"]


def key_of(handle: bytes) -> bytes:
    """Return the key that a person has now."""
    return call("identity", "member_of_handle", handle)["member"]


def require_officers(keys: list, org: str):
    """Fail unless the persons who used these keys are officers today."""
    for key in keys:
        now = is_officer(key_of(handle_of(key)), org)
        require(now, "OFFICER_GONE", "One of the two officers is none any more: propose it again.")


def is_callers(handle: bytes) -> bool:
    """Tell whether the caller is the active member of a handle."""
    found = call("identity", "member_of_handle", handle)
    return found["member"] == ctx.caller and found["status"] == "active"


def find_person(handle: bytes) -> dict:
    require(len(handle) == HANDLE_BYTES, "HANDLE_SIZE_WRONG", "A handle has 32 bytes.")
    found = call("identity", "member_of_handle", handle)
    require(found is not None, "HANDLE_UNKNOWN", "Nobody is registered under this handle.")
    return found


def check_persons(handle: bytes, representative: bytes):
    """Fail unless the one can be represented now, and the other can act for somebody."""
    is_subject = call("identity", "role_of", find_person(handle)["member"]) == "subject"
    require(is_subject, "REPRESENTED_WRONG", "Only an active subject can be represented.")
    role = call("identity", "role_of", find_person(representative)["member"])
    able = role in REPRESENTATIVE_ROLES and representative != handle and not is_represented(representative)
    require(able, "REPRESENTATIVE_WRONG", "Another subject, member of the staff or officer who acts for themselves may.")


def is_represented(handle: bytes) -> bool:
    """Tell whether somebody acts for this person."""
    mandate_id = state.get(b"of/" + handle)
    if mandate_id is None:
        return False
    entry = state.get(b"mandate/" + mandate_id)
    return entry["status"] == ACTIVE and ctx.time < entry["until_ms"]


def check_time(until_ms: int):
    whole = until_ms % UNTIL_STEP_MS == 0 and ctx.time < until_ms and until_ms <= ctx.time + LASTS_MAX_MS
    require(whole, "PERIOD_WRONG", "A mandate ends on five full minutes, in 366 days at most.")


def require_mandate(mandate_id: bytes) -> dict:
    require_direct()
    require(len(mandate_id) == ID_BYTES, "MANDATE_UNKNOWN", "A mandate's id has 32 bytes.")
    entry = state.get(b"mandate/" + mandate_id)
    require(entry is not None, "MANDATE_UNKNOWN", "There is no such mandate.")
    return entry


def require_step(entry: dict, status: str):
    require(entry["status"] == status, "MANDATE_DECIDED", "That is not the mandate's next step.")
    require(ctx.time <= entry["ends_ms"], "MANDATE_LAPSED", "Nobody agreed in time: propose it again.")
    require(ctx.time < entry["until_ms"], "MANDATE_LAPSED", "Its time is over: propose another.")
    check_persons(entry["handle"], entry["representative"])


def holds(entry: dict) -> bool:
    """Tell whether a mandate is in force in this block."""
    if entry["status"] != ACTIVE or ctx.time >= entry["until_ms"] or is_represented(entry["representative"]):
        return False
    if call("identity", "removed_ms", entry["org"]) >= entry["proposed_ms"]:
        return False
    if call("identity", "role_of", key_of(entry["handle"])) != "subject":
        return False
    return call("identity", "role_of", key_of(entry["representative"])) in REPRESENTATIVE_ROLES


def is_over(entry: dict) -> bool:
    """Tell whether a mandate that nobody ended has ended by itself, or a proposal of one."""
    if entry["status"] == ACTIVE:
        return not holds(entry)
    return entry["status"] != ENDED and ctx.time > min(entry["ends_ms"], entry["until_ms"] - 1)


def count_today(key: bytes) -> int:
    """Count one more of today (UTC); return how many there were before."""
    today = ctx.time // DAY_MS
    day, count = state.get(key, [today, 0])
    if day != today:
        count = 0
    state.put(key, [today, count + 1])
    return count


@export
def propose(handle: bytes, representative: bytes, papers: bytes, acts: list, until_ms: int):
    """Propose that a member acts for a person who cannot. Who may call: an officer of the represented member's organisation.

    `papers` is a salted hash of the reason and of what the guardian showed; `acts` says for what, and `until_ms` how long.
    """
    require_direct()
    org = find_person(handle)["org"]
    require_officer(org)
    check_persons(handle, representative)
    require(handle_of(ctx.caller) != representative, "OFFICER_CONCERNED", "An officer gives no mandate to themselves.")
    require(len(papers) == PAPERS_BYTES, "PAPERS_WRONG", "The hash of the papers has 32 bytes.")
    require(0 < len(acts) and len(acts) <= len(ACTS), "ACT_UNKNOWN", "A mandate names what it is for.")
    for act in acts:
        require(isinstance(act, str) and act in ACTS, "ACT_UNKNOWN", "There is no mandate for that.")
    check_time(until_ms)
    before = state.get(b"of/" + handle)
    if before is not None:
        entry = state.get(b"mandate/" + before)
        require(is_over(entry), "MANDATE_EXISTS", "There is a mandate for this person, or a proposal of one: end it first.")
        finish(before, entry)
    within = count_today(b"proposals/" + handle_of(ctx.caller)) < PROPOSALS_A_DAY_MAX_COUNT
    require(within, "WORDS_TOO_MANY", "An officer proposes 64 mandates a day.")
    number = state.get(b"mandate-count", 0)
    entry = {
        "number": number,
        "handle": handle,
        "representative": representative,
        "org": org,
        "papers": papers,
        "acts": acts,
        "until_ms": until_ms,
        "status": PROPOSED,
        "proposer": ctx.caller,
        "approver": b"",
        "proposed_ms": ctx.time,
        "approved_ms": 0,
        "accepted_ms": 0,
        "ends_ms": ctx.time + APPROVE_MS,
        "ended_ms": 0,
        "ended_by": b"",
    }
    state.put(b"mandate-count", number + 1)
    state.put(b"mandate-number/" + u64(number), ctx.txid)
    state.put(b"of/" + handle, ctx.txid)
    state.put(b"mandate/" + ctx.txid, entry)
    for person in [handle, representative]:
        count = state.get(b"person-count/" + person, 0)
        state.put(b"person/" + person + u32(count), ctx.txid)
        state.put(b"person-count/" + person, count + 1)
    told = {"mandate_id": ctx.txid, "handle": handle, "representative": representative, "org": org, "acts": acts}
    told.update({"until_ms": until_ms, "ends_ms": entry["ends_ms"], "number": number})
    emit("proposed", told)


@export
def approve(mandate_id: bytes):
    """Agree to a mandate within three days, having seen the papers.

    Who may call: another officer of the represented member's organisation.
    """
    entry = require_mandate(mandate_id)
    require_officer(entry["org"])
    require_step(entry, PROPOSED)
    own = handle_of(ctx.caller)
    require(own != handle_of(entry["proposer"]), "OFFICER_THE_SAME", "Who proposed it cannot approve it.")
    require(own != entry["representative"], "OFFICER_CONCERNED", "An officer gives no mandate to themselves.")
    require_officers([entry["proposer"]], entry["org"])
    entry["status"] = APPROVED
    entry["approver"] = ctx.caller
    entry["approved_ms"] = ctx.time
    entry["ends_ms"] = ctx.time + ACCEPT_MS
    state.put(b"mandate/" + mandate_id, entry)
    emit("approved", {"mandate_id": mandate_id, "officer": ctx.caller, "ends_ms": entry["ends_ms"]})


@export
def accept(mandate_id: bytes):
    """Take a mandate on within seven days; from this block on it is in force. Who may call: the representative it names."""
    entry = require_mandate(mandate_id)
    require(is_callers(entry["representative"]), "NOT_THE_REPRESENTATIVE", "Only the representative accepts it.")
    require_step(entry, APPROVED)
    require_officers([entry["proposer"], entry["approver"]], entry["org"])
    entry["status"] = ACTIVE
    entry["accepted_ms"] = ctx.time
    state.put(b"mandate/" + mandate_id, entry)
    emit("accepted", {"mandate_id": mandate_id, "member": ctx.caller, "until_ms": entry["until_ms"]})


@export
def end(mandate_id: bytes):
    """End a mandate, or a proposal of one, with this block: what was consented to under it is withdrawn.

    Who may call: the represented, the representative, or an officer of the organisation.
    """
    entry = require_mandate(mandate_id)
    concerned = is_callers(entry["handle"]) or is_callers(entry["representative"])
    allowed = concerned or is_officer(ctx.caller, entry["org"])
    require(allowed, "NOT_OF_THE_MANDATE", "Only the two persons and officers of the organisation may end it.")
    require(entry["status"] != ENDED, "MANDATE_ENDED", "The mandate has ended already.")
    finish(mandate_id, entry)


@export
def close(mandate_id: bytes):
    """Withdraw what was consented to under a mandate that holds no more, and note its end. Who may call: an active member.

    It does so when its time is over, one of the two is no active member any more, or the organisation was removed. While
    somebody acts for the representative it rests: it holds again afterwards, unless it was closed meanwhile.
    """
    entry = require_mandate(mandate_id)
    require(call("identity", "role_of", ctx.caller) != "", "NOT_A_MEMBER", "Only an active member may do that.")
    require(entry["status"] != ENDED, "MANDATE_ENDED", "The mandate has ended already.")
    require(is_over(entry), "MANDATE_HOLDS", "The mandate, or its proposal, is not over yet.")
    finish(mandate_id, entry)


def finish(mandate_id: bytes, entry: dict):
    was_active = entry["status"] == ACTIVE
    entry["status"] = ENDED
    entry["ended_ms"] = ctx.time
    entry["ended_by"] = ctx.caller
    state.put(b"mandate/" + mandate_id, entry)
    state.delete(b"of/" + entry["handle"])
    if was_active:
        call("consent", "end_mandate", entry["handle"], mandate_id)
    emit("ended", {"mandate_id": mandate_id, "member": ctx.caller})


@export
def note(mandate_id: bytes, kind: str, data: dict):
    """Append what was done under a mandate to its trail, 64 givings a day at most. Who may call: the contract `consent`.

    What is not given any more cannot be refused either: the noes of a day have an end, too.
    """
    require(ctx.calling_contract == "consent", "NOT_THE_CONSENT_CONTRACT", "Only the contract consent may do that.")
    within = count_today(b"day/" + mandate_id) < ACTS_A_DAY_MAX_COUNT or kind != GIVEN
    require(within, "WORDS_TOO_MANY", "A day takes 64 acts under a mandate; a no it takes always.")
    number = state.get(b"act-count/" + mandate_id, 0)
    entry = {"kind": kind, "time": ctx.time, "height": ctx.height, "txid": ctx.txid, "data": data}
    state.put(b"act/" + mandate_id + u32(number), entry)
    state.put(b"act-count/" + mandate_id, number + 1)
    emit("acted", {"mandate_id": mandate_id, "kind": kind, "number": number})


@view
def acting_for(handle: bytes, key: bytes, act: str) -> dict | None:
    """Return {mandate_id, until_ms} of the mandate by which a member may do this for a person now, or None."""
    mandate_id = state.get(b"of/" + handle)
    if mandate_id is None:
        return None
    entry = state.get(b"mandate/" + mandate_id)
    if act not in entry["acts"] or not holds(entry) or key_of(entry["representative"]) != key:
        return None
    return {"mandate_id": mandate_id, "until_ms": entry["until_ms"]}


@view
def mandate(mandate_id: bytes) -> dict | None:
    """Return a mandate's state, or None."""
    return state.get(b"mandate/" + mandate_id)


@view
def mandates(first: int, limit: int) -> list:
    """Return the ids of at most 128 mandates from number `first` on, in order."""
    count = state.get(b"mandate-count", 0)
    found = []
    for number in range(max(0, first), min(count, first + min(limit, PAGE_MAX_COUNT))):
        found.append(state.get(b"mandate-number/" + u64(number)))
    return found


@view
def trail(mandate_id: bytes, first: int, limit: int) -> list:
    """Return at most 128 acts under a mandate from number `first` on, in order."""
    count = state.get(b"act-count/" + mandate_id, 0)
    found = []
    for number in range(max(0, first), min(count, first + min(limit, PAGE_MAX_COUNT))):
        found.append(state.get(b"act/" + mandate_id + u32(number)))
    return found

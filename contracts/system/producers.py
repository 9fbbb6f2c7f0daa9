"""Who produces blocks, and by which settings. Must never leave the chain without a producer that leads.

A candidate enters the schedule once a majority of the active organisations votes for it and it said not long ago that it
is ready. It keeps its seat while one organisation at least votes for it, no majority wants it removed, and no more than
`max_producers` others have more votes. Evidence suspends it; a new majority of votes reinstates it. Who leaves the network
takes its votes along; who gets new keys keeps only its votes for those that have a seat. What it keeps: docs/reference/state.md.
"""

KEY_BYTES = 33
HASH_BYTES = 32
SIGNATURE_BYTES = 64
CANDIDATES_MAX_COUNT = 42
PRODUCERS_MAX_COUNT = 21
TOLERANT_MIN_COUNT = 4
READY_MAX_AGE_MS = 600000
READY_MAX_LAG_BLOCKS = 1000
SUCCESSORS_MAX_COUNT = 16
VOTES_MAX_COUNT = 1000
NUMBER_MAX = 9007199254740992
EVIDENCE_TAGS = {"vote": "blockrobot/vote", "proposal": "blockrobot/proposal"}


@genesis
def genesis(producers: list, organisations: list, settings: dict):
    """Write the first schedule: [[key, node, organisation]] in the order of turns, all organisations voting for it."""
    keys = []
    for key, name, organisation in producers:
        entry = new_candidate(name, organisation, sorted(organisations))
        entry["status"] = "producing"
        state.put(b"candidate/" + key, entry)
        keys.append(key)
    state.put(b"keys", keys)
    state.put(b"max_producers", PRODUCERS_MAX_COUNT)
    state.put(b"epoch", {"number": 0, "producers": keys, "leaderless": [], "settings": settings, "height": 0})


def new_candidate(name: str, organisation: str, votes: list) -> dict:
    return {
        "name": name,
        "organisation": organisation,
        "votes": votes,
        "removals": [],
        "status": "candidate",
        "since_ms": ctx.time,
        "ready_height": 0,
        "ready_ms": 0,
        "ready_root": b"",
        "suspended_height": 0,
        "reinstated_epoch": 0,
        "evidence": {},
        "successor": b"",
    }


# The election


def is_majority(names: list, organisations: list) -> bool:
    """Only active organisations are among the names: who leaves takes its votes along."""
    return len(names) > len(organisations) // 2


def is_ready(entry: dict) -> bool:
    fresh = entry["ready_ms"] > 0 and ctx.time - entry["ready_ms"] <= READY_MAX_AGE_MS
    return fresh and ctx.height - entry["ready_height"] <= READY_MAX_LAG_BLOCKS


def is_electable(entry: dict, organisations: list) -> bool:
    if entry["status"] == "producing":
        return len(entry["votes"]) > 0
    return entry["status"] == "candidate" and is_majority(entry["votes"], organisations) and is_ready(entry)


def elect(organisations: list, by_decision: bool):
    """Seat the candidates with the most votes, and write the epoch anew if that changes anything.

    Ties go to the older candidacy, then to the smaller key. Who stays keeps its place in the order of turns. Evidence may
    leave only suspended producers, which then all lead; no decision of organisations may.
    """
    epoch = state.get(b"epoch")
    maximum = state.get(b"max_producers")
    entries = {}
    ranked = []
    for key in state.get(b"keys"):
        entry = state.get(b"candidate/" + key)
        entries[key] = entry
        if is_electable(entry, organisations):
            votes = min(VOTES_MAX_COUNT, len(entry["votes"]))
            ranked.append(u32(VOTES_MAX_COUNT - votes) + u64(entry["since_ms"]) + key)
    chosen = [rank[12:] for rank in sorted(ranked)[:maximum]]
    require(len(chosen) > 0 or not by_decision, "LAST_PRODUCER", "One producer that is not suspended must remain.")
    suspended = []
    if len(chosen) < TOLERANT_MIN_COUNT:
        seated = [key for key in epoch["producers"] if key in entries and entries[key]["status"] == "suspended"]
        suspended = seated[: maximum - len(chosen)]
    producers = [key for key in epoch["producers"] if key in chosen or key in suspended]
    for key in chosen:
        if key not in producers:
            producers.append(key)
    for key, entry in entries.items():
        if key in chosen and entry["status"] != "producing":
            entry["status"] = "producing"
            state.put(b"candidate/" + key, entry)
        elif entry["status"] == "producing" and key not in chosen:
            entry["status"] = "candidate"
            entry["ready_ms"] = 0
            state.put(b"candidate/" + key, entry)
    leaderless = [place for place, key in enumerate(producers) if key in suspended]
    if len(leaderless) == len(producers):
        leaderless = []
    put_epoch(epoch, producers, leaderless, epoch["settings"])


def put_epoch(epoch: dict, producers: list, leaderless: list, settings: dict):
    """Write what follows, if it differs. Within one block a second change takes the place of the first."""
    require(len(producers) > 0, "LAST_PRODUCER", "At least one producer must remain.")
    same = epoch["producers"] == producers and epoch["leaderless"] == leaderless and epoch["settings"] == settings
    if same:
        return
    number = epoch["number"]
    if epoch["height"] != ctx.height:
        number += 1
    next = {
        "number": number,
        "producers": producers,
        "leaderless": leaderless,
        "settings": settings,
        "height": ctx.height,
    }
    state.put(b"epoch", next)
    emit("epoch", {"number": number, "height": ctx.height, "producers": len(producers)})


def require_candidate(key: bytes) -> dict:
    require(len(key) == KEY_BYTES, "CANDIDATE_UNKNOWN", "A producer's key has 33 bytes.")
    entry = state.get(b"candidate/" + key)
    require(entry is not None and entry["status"] != "removed", "CANDIDATE_UNKNOWN", "No candidate has this key.")
    return entry


def require_admin() -> list:
    """Return [the active organisation that the caller speaks for, all active organisations]."""
    require(ctx.calling_contract == "", "CALL_INDIRECT", "Only a transaction does that, no other contract in its name.")
    organisation, organisations = call("membership", "electorate", ctx.caller)
    require(organisation != "", "NOT_AN_ADMIN", "Only an admin of an active organisation may do that.")
    return [organisation, organisations]


# What organisations decide


@export
def propose(key: bytes):
    """Make a node's producer key a candidate, with one's own vote. Who may call: an admin of an active organisation."""
    organisation, organisations = require_admin()
    require(len(key) == KEY_BYTES, "NODE_UNKNOWN", "A producer's key has 33 bytes.")
    node = call("membership", "node_of_key", key)
    require(node is not None, "NODE_UNKNOWN", "No active node has this producer key: add the node first.")
    known = state.get(b"candidate/" + key)
    require(known is None or known["status"] == "removed", "CANDIDATE_EXISTS", "The key is a candidate already.")
    keys = state.get(b"keys")
    require(len(keys) < CANDIDATES_MAX_COUNT, "CANDIDATES_TOO_MANY", "There are at most 42 candidates.")
    entry = new_candidate(node["name"], node["organisation"], [organisation])
    if known is not None:
        entry["reinstated_epoch"] = known["reinstated_epoch"]
        entry["evidence"] = known["evidence"]
        entry["suspended_height"] = known["suspended_height"]
        if known["suspended_height"] > 0:
            entry["status"] = "suspended"
    state.put(b"candidate/" + key, entry)
    state.put(b"keys", keys + [key])
    emit("candidate", {"key": key, "name": node["name"], "organisation": organisation})
    decide(key, entry, organisations)


@export
def approve(key: bytes):
    """Vote for a candidate, or for a suspended one's return. Who may call: an admin of an active organisation."""
    organisation, organisations = require_admin()
    entry = require_candidate(key)
    known = organisation not in entry["votes"] or organisation in entry["removals"]
    require(known, "APPROVED_ALREADY", "The organisation votes for it already; each has one voice.")
    if organisation not in entry["votes"]:
        entry["votes"].append(organisation)
    entry["removals"] = [name for name in entry["removals"] if name != organisation]
    state.put(b"candidate/" + key, entry)
    emit("approved", {"key": key, "organisation": organisation})
    decide(key, entry, organisations)


def decide(key: bytes, entry: dict, organisations: list):
    """Reinstate a suspended candidate that a majority votes for, and elect."""
    if entry["status"] == "suspended" and is_majority(entry["votes"], organisations):
        epoch = state.get(b"epoch")
        entry["status"] = "candidate"
        if key in epoch["producers"]:
            entry["status"] = "producing"
        entry["suspended_height"] = 0
        entry["reinstated_epoch"] = epoch["number"] + 1
        state.put(b"candidate/" + key, entry)
        emit("reinstated", {"key": key, "name": entry["name"]})
    elect(organisations, False)


@export
def withdraw(key: bytes):
    """Take one's vote back. Who may call: an admin of an active organisation that votes for it."""
    organisation, organisations = require_admin()
    entry = require_candidate(key)
    require(organisation in entry["votes"], "VOTE_MISSING", "The organisation does not vote for it.")
    entry["votes"] = [name for name in entry["votes"] if name != organisation]
    state.put(b"candidate/" + key, entry)
    emit("withdrawn", {"key": key, "organisation": organisation})
    elect(organisations, True)


@export
def remove(key: bytes):
    """Stand for a producer's removal: its own organisation suffices, otherwise a majority is needed.

    Who may call: an admin of an active organisation.
    """
    organisation, organisations = require_admin()
    entry = require_candidate(key)
    again = organisation in entry["removals"]
    require(not again, "APPROVED_ALREADY", "The organisation stands for its removal already; each has one voice.")
    entry["removals"].append(organisation)
    entry["votes"] = [name for name in entry["votes"] if name != organisation]
    state.put(b"candidate/" + key, entry)
    emit("removal_approved", {"key": key, "organisation": organisation})
    if organisation == entry["organisation"] or is_majority(entry["removals"], organisations):
        drop([key])
    elect(organisations, True)


def drop(keys: list):
    """Take candidates out for good; their entries stay, for evidence that may come to light."""
    for key in keys:
        entry = state.get(b"candidate/" + key)
        entry["status"] = "removed"
        entry["votes"] = []
        state.put(b"candidate/" + key, entry)
        emit("removed", {"key": key, "name": entry["name"]})
    state.put(b"keys", [key for key in state.get(b"keys") if key not in keys])


# What producers and candidates say


@export
def ready(height: int, state_root: bytes):
    """Say that one follows the chain, up to a block of the last 1,000. Who may call: a candidate that has no seat."""
    require(len(ctx.caller) == KEY_BYTES, "CANDIDATE_UNKNOWN", "No candidate has this key.")
    entry = require_candidate(ctx.caller)
    require(entry["status"] != "producing", "PRODUCING_ALREADY", "The candidate has a seat.")
    require(len(state_root) == HASH_BYTES, "ROOT_WRONG", "A state root has 32 bytes.")
    known = height >= 0 and height < ctx.height and ctx.height - height <= READY_MAX_LAG_BLOCKS
    require(known, "HEIGHT_WRONG", "The height must be of one of the last 1,000 blocks.")
    entry["ready_height"] = height
    entry["ready_ms"] = ctx.time
    entry["ready_root"] = state_root
    state.put(b"candidate/" + ctx.caller, entry)
    emit("ready", {"key": ctx.caller, "name": entry["name"], "height": height})
    organisations = call("membership", "active_organisations")
    if entry["status"] == "candidate" and is_majority(entry["votes"], organisations):
        elect(organisations, True)


def is_signed(tag: str, key: bytes, message: bytes, signature: bytes) -> bool:
    """A compact signature says who made it only together with one more bit: both are tried."""
    if len(signature) != SIGNATURE_BYTES:
        return False
    return recover(tag, signature + b"\x00", message) == key or recover(tag, signature + b"\x01", message) == key


def find_successor(key: bytes) -> bytes:
    """Return the key that now stands in the place of this one; a new key is no way out."""
    for _ in range(SUCCESSORS_MAX_COUNT):
        successor = state.get(b"candidate/" + key)["successor"]
        if len(successor) == 0:
            return key
        key = successor
    return key


@export
def accuse(
    kind: str,
    epoch: int,
    round: int,
    producer: bytes,
    first_id: bytes,
    first_signature: bytes,
    second_id: bytes,
    second_signature: bytes,
):
    """Show that a producer signed two blocks in one round (`vote` or `proposal`), the smaller id first; suspends it.

    One that was removed meanwhile is marked, and suspended if it ever comes back. Who may call: a producer or candidate.
    """
    require_candidate(ctx.caller)
    require(kind in EVIDENCE_TAGS, "EVIDENCE_KIND_UNKNOWN", "Evidence is of two votes or of two proposals.")
    current = state.get(b"epoch")
    require(epoch >= 0 and epoch <= current["number"], "EVIDENCE_WRONG", "There was no such epoch.")
    require(round >= 0 and round < NUMBER_MAX, "EVIDENCE_WRONG", "There is no such round.")
    known = len(producer) == KEY_BYTES and state.has(b"candidate/" + producer)
    require(known, "CANDIDATE_UNKNOWN", "No producer has or had this key.")
    sized = len(first_id) == HASH_BYTES and len(second_id) == HASH_BYTES
    require(sized and first_id < second_id, "EVIDENCE_WRONG", "The two ids must differ, the smaller one first.")
    place = b"accused/" + producer + u32(epoch) + u64(round)
    require(not state.has(place), "EVIDENCE_KNOWN", "The producer is accused of this round already.")
    suspect = find_successor(producer)
    entry = state.get(b"candidate/" + suspect)
    require(entry["suspended_height"] == 0, "SUSPENDED_ALREADY", "The producer is suspended already.")
    require(epoch >= entry["reinstated_epoch"], "EVIDENCE_OLD", "The producer was reinstated since.")
    tag = EVIDENCE_TAGS[kind]
    before = ctx.chain + u32(epoch) + u64(round)
    first = is_signed(tag, producer, before + first_id, first_signature)
    second = is_signed(tag, producer, before + second_id, second_signature)
    require(first and second, "EVIDENCE_FORGED", "The producer did not sign both.")
    state.put(place, True)
    has_left = entry["status"] == "removed"
    if not has_left:
        entry["status"] = "suspended"
    entry["votes"] = []
    entry["ready_ms"] = 0
    entry["suspended_height"] = ctx.height
    entry["evidence"] = {
        "kind": kind,
        "epoch": epoch,
        "round": round,
        "producer": producer,
        "first_id": first_id,
        "first_signature": first_signature,
        "second_id": second_id,
        "second_signature": second_signature,
        "accuser": ctx.caller,
        "height": ctx.height,
    }
    state.put(b"candidate/" + suspect, entry)
    emit("suspended", {"key": suspect, "name": entry["name"], "kind": kind, "epoch": epoch, "round": round})
    if not has_left:
        elect(call("membership", "active_organisations"), False)


# What the other system contracts decide


@export
def rekey(old: bytes, new: bytes):
    """Put a producer's new key in place of the old one. Who may call: the contract `membership`."""
    require(ctx.calling_contract == "membership", "NOT_THE_MEMBERSHIP_CONTRACT", "Only the organisations may, together.")
    entry = state.get(b"candidate/" + old)
    if entry is None:
        return
    state.put(b"candidate/" + new, entry)
    replaced = state.get(b"candidate/" + old)
    replaced["status"] = "removed"
    replaced["votes"] = []
    replaced["successor"] = new
    state.put(b"candidate/" + old, replaced)
    if entry["status"] == "removed":
        return
    state.put(b"keys", put_in_place(state.get(b"keys"), old, new))
    epoch = state.get(b"epoch")
    put_epoch(epoch, put_in_place(epoch["producers"], old, new), epoch["leaderless"], epoch["settings"])
    emit("rekeyed", {"old": old, "new": new, "name": entry["name"]})


def put_in_place(keys: list, old: bytes, new: bytes) -> list:
    return [new if key == old else key for key in keys]


@export
def remove_keys(keys: list, organisations: list, leaving_organisation: str):
    """Remove the producers of nodes that left, and the votes of their organisation if it left with them.

    Who may call: the contract `membership`.
    """
    require(ctx.calling_contract == "membership", "NOT_THE_MEMBERSHIP_CONTRACT", "Only the organisations may, together.")
    known = state.get(b"keys")
    drop([key for key in keys if key in known])
    if leaving_organisation != "":
        strip(leaving_organisation, True)
    elect(organisations, True)


@export
def forget_voice(organisation: str):
    """Count no more what an organisation said with keys that were replaced, but for its votes for those with a seat.

    Those would fall with a vote that was never taken back. Who may call: the contract `membership`.
    """
    require(ctx.calling_contract == "membership", "NOT_THE_MEMBERSHIP_CONTRACT", "Only the organisations may, together.")
    strip(organisation, False)


def strip(organisation: str, with_seats: bool):
    for key in state.get(b"keys"):
        entry = state.get(b"candidate/" + key)
        counted = organisation in entry["votes"] and (with_seats or entry["status"] != "producing")
        if counted:
            entry["votes"] = [name for name in entry["votes"] if name != organisation]
        if counted or organisation in entry["removals"]:
            entry["removals"] = [name for name in entry["removals"] if name != organisation]
            state.put(b"candidate/" + key, entry)


@export
def change_setting(name: str, value: int | str):
    """Put a setting into force. Who may call: the contract `settings`, which checks the value."""
    require(ctx.calling_contract == "settings", "NOT_THE_SETTINGS_CONTRACT", "Only the contract settings may do that.")
    if name == "max_producers":
        state.put(b"max_producers", value)
        organisations = call("membership", "active_organisations")
        elect(organisations, True)
        return
    epoch = state.get(b"epoch")
    settings = epoch["settings"].copy()
    settings[name] = value
    put_epoch(epoch, epoch["producers"], epoch["leaderless"], settings)


@view
def current() -> dict:
    """Return the epoch that is decided: {number, producers, leaderless, settings, height}."""
    return state.get(b"epoch")


@view
def settings_in_force() -> dict:
    """Return all settings by name, with max_producers."""
    settings = state.get(b"epoch")["settings"]
    settings["max_producers"] = state.get(b"max_producers")
    return settings


@view
def candidate(key: bytes) -> dict | None:
    """Return a candidate's state, or None."""
    return state.get(b"candidate/" + key)


@view
def candidates() -> list:
    """Return the keys of all that are not removed, the oldest candidacy first."""
    return state.get(b"keys")

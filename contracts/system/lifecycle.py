"""Which contracts the network runs, in which version, as the organisations decide. Must never run what was not approved.

The machine carries out what is due at the beginning of a block. It keeps the table of contracts and the trials itself, out
of reach of any version of this contract, and writes copies here. The sources that ship with BlockRobot are not in the
state: genesis names them. What it keeps: docs/reference/state.md.

A source comes in parts, each paid for when it comes, since the price of compiling all of it would not fit into one call.
It is compiled in a call that does nothing else, after its hash was compared, and whose result stays whatever it is: so
that each upload buys one compiling and no more.
"""

HASH_BYTES = 32
SOURCE_TAG = "blockrobot/contract-source"
PART_MAX_BYTES = 6000
PARTS_MAX_COUNT = 10
UPLOADS_MAX_COUNT = 4
CONTRACTS_MAX_COUNT = 64
VERSIONS_MAX_COUNT = 1000
ENTRIES_MAX_COUNT = 100
DUE_MAX_COUNT = 32
NOTE_MAX_CHARS = 280
HIDDEN_IN_NOTES = (
    "\x00\x01\x02\x03\x04\x05\x06\x07\x08\x09\x0a\x0b\x0c\x0d\x0e\x0f\x10\x11\x12\x13\x14\x15\x16\x17\x18\x19\x1a\x1b\x1c\x1d"
    + "\x1e\x1f\x7f\x80\x81\x82\x83\x84\x85\x86\x87\x88\x89\x8a\x8b\x8c\x8d\x8e\x8f\x90\x91\x92\x93\x94\x95\x96\x97\x98\x99\x9a\x9b"
    + "\x9c\x9d\x9e\x9f\xad\u061c\u200b\u200c\u200d\u200e\u200f\u2028\u2029\u202a\u202b\u202c\u202d\u202e\u2060\u2061\u2062"
    + "\u2063\u2064\u2066\u2067\u2068\u2069\u206a\u206b\u206c\u206d\u206e\u206f\ufeff\ufff9\ufffa\ufffb"
)
AHEAD_MAX_BLOCKS = 10000000
NAME_MAX_CHARS = 32
NAME_CHARS = "abcdefghijklmnopqrstuvwxyz0123456789-_"
RESERVED_NAMES = ("blockrobot", "chain", "contract", "ctx", "genesis", "machine", "state", "system")
GOVERNING = (
    "access",
    "audit",
    "consent",
    "erasure",
    "forms",
    "identity",
    "lifecycle",
    "mandates",
    "membership",
    "officers",
    "producers",
    "records",
    "rights",
    "settings",
)
FIELDS = {
    "deploy": {"name": "str", "source_hash": "bytes", "height": "int", "delay": "int", "note": "str"},
    "activate": {"name": "str", "version": "int", "height": "int", "delay": "int", "note": "str"},
    "disable": {"name": "str", "version": "int", "height": "int", "delay": "int", "note": "str"},
    "keep": {"name": "str", "version": "int"},
}


@genesis
def genesis(contracts: list):
    """Write the contracts that are there from the beginning: [[name, facts as check_source gives them]]."""
    table = {}
    for name, facts in contracts:
        record = new_version(facts, "Shipped with BlockRobot.", "", b"")
        record["status"] = "active"
        state.put(version_key(name, 1), record)
        state.put(b"versions/" + name.encode(), 1)
        table[name] = [1, facts["source_hash"], True, ctx.height]
    state.put(b"table", table)


def version_key(name: str, version: int) -> bytes:
    return b"version/" + name.encode() + b"/" + u32(version)


def new_version(facts: dict, note: str, organisation: str, proposal_id: bytes) -> dict:
    record = {"note": note, "organisation": organisation, "proposal_id": proposal_id, "approved_height": ctx.height}
    record.update({"status": "approved", "since_height": 0, "failure": ""})
    record.update(facts)
    return record


def require_direct():
    require(ctx.calling_contract == "", "CALL_INDIRECT", "Only a transaction does that, no other contract in its name.")


def require_admin() -> str:
    """Return the active organisation that the caller speaks for; no other contract speaks in their name."""
    require_direct()
    organisation = call("membership", "electorate", ctx.caller)[0]
    require(organisation != "", "NOT_AN_ADMIN", "Only an admin of an active organisation may do that.")
    return organisation


# Uploads


def upload_prefix(organisation: str, source_hash: bytes) -> bytes:
    return b"upload/" + organisation.encode() + b"/" + source_hash


def read_uploads(organisation: str) -> list:
    return state.get(b"uploads/" + organisation.encode(), [])


def verdict_key(organisation: str, source_hash: bytes) -> bytes:
    return b"verdict/" + organisation.encode() + b"/" + source_hash


def drop_upload(organisation: str, entry: dict):
    state.delete(verdict_key(organisation, entry["source_hash"]))
    prefix = upload_prefix(organisation, entry["source_hash"])
    for place in entry["places"]:
        state.delete(prefix + u32(place))


@export
def upload(source_hash: bytes, parts: int, place: int, data: bytes):
    """Take in one part of a source, of 1 to 6,000 bytes; the first has place 0. A fifth upload drops the oldest.

    Once `check_upload` has judged a source its parts stay as they are. Who may call: an admin of an active organisation.
    """
    organisation = require_admin()
    require(len(source_hash) == HASH_BYTES, "HASH_WRONG", "A source's hash has 32 bytes.")
    require(0 < parts and parts <= PARTS_MAX_COUNT, "PART_WRONG", "A source has 1 to 10 parts.")
    require(0 <= place and place < parts, "PART_WRONG", "There is no such part.")
    require(0 < len(data) and len(data) <= PART_MAX_BYTES, "PART_WRONG", "A part has 1 to 6,000 bytes.")
    if state.has(verdict_key(organisation, source_hash)):
        return
    charge_source(data)
    uploads = read_uploads(organisation)
    known = [entry for entry in uploads if entry["source_hash"] == source_hash and entry["parts"] == parts]
    if len(known) > 0:
        entry = known[0]
    else:
        for other in uploads:
            if other["source_hash"] == source_hash:
                drop_upload(organisation, other)
        uploads = [other for other in uploads if other["source_hash"] != source_hash]
        if len(uploads) >= UPLOADS_MAX_COUNT:
            drop_upload(organisation, uploads[0])
            uploads = uploads[1:]
        entry = {"source_hash": source_hash, "parts": parts, "places": []}
    if place not in entry["places"]:
        entry["places"].append(place)
    uploads = [other for other in uploads if other["source_hash"] != source_hash]
    uploads.append(entry)
    state.put(upload_prefix(organisation, source_hash) + u32(place), data)
    state.put(b"uploads/" + organisation.encode(), uploads)
    emit("uploaded", {"organisation": organisation, "source_hash": source_hash, "place": place, "parts": parts})


def find_upload(organisation: str, source_hash: bytes) -> dict:
    """Return a complete upload."""
    found = [entry for entry in read_uploads(organisation) if entry["source_hash"] == source_hash]
    known = len(found) > 0 and len(found[0]["places"]) == found[0]["parts"]
    require(known, "SOURCE_MISSING", "The proposing organisation has not uploaded all parts of this source.")
    return found[0]


def read_parts(organisation: str, entry: dict) -> list:
    prefix = upload_prefix(organisation, entry["source_hash"])
    return [state.get(prefix + u32(place)) for place in range(entry["parts"])]


@export
def check_upload(source_hash: bytes):
    """Have an uploaded source compiled, and note what it is, or what is wrong with it; a second time nothing is done.

    Nothing that can fail may follow the compiling. Who may call: an admin of an active organisation.
    """
    organisation = require_admin()
    require(len(source_hash) == HASH_BYTES, "HASH_WRONG", "A source's hash has 32 bytes.")
    if state.has(verdict_key(organisation, source_hash)):
        return
    data = b""
    for part in read_parts(organisation, find_upload(organisation, source_hash)):
        data += part
    same = tagged_hash(SOURCE_TAG, data) == source_hash
    require(same, "SOURCE_OTHER", "The uploaded parts have another hash.")
    problem, facts = check_source(data)
    if problem == "" and len(facts["entries"]) > ENTRIES_MAX_COUNT:
        problem = "A contract has at most 100 entries."
        facts = {}
    state.put(verdict_key(organisation, source_hash), [problem, facts])
    emit("checked", {"organisation": organisation, "source_hash": source_hash, "problem": problem})


def require_facts(organisation: str, source_hash: bytes) -> dict:
    """Return what is known of an uploaded source that was checked and found good."""
    find_upload(organisation, source_hash)
    verdict = state.get(verdict_key(organisation, source_hash))
    require(verdict is not None, "SOURCE_UNCHECKED", "The uploaded source was not checked yet: call check_upload.")
    problem, facts = verdict
    require(problem == "", "SOURCE_INVALID", problem)
    return facts


def store_source(organisation: str, entry: dict, size_bytes: int):
    """Move an approved source to where the machine looks for it."""
    place_of = b"source/" + entry["source_hash"]
    if not state.has(place_of):
        for place, part in enumerate(read_parts(organisation, entry)):
            state.put(place_of + b"/" + u32(place), part)
        state.put(place_of, {"parts": entry["parts"], "size_bytes": size_bytes})
    drop_upload(organisation, entry)
    uploads = [other for other in read_uploads(organisation) if other["source_hash"] != entry["source_hash"]]
    state.put(b"uploads/" + organisation.encode(), uploads)


# What a proposal may ask for


def is_of(value: object, kind: str) -> bool:
    if kind == "str":
        return isinstance(value, str)
    if kind == "int":
        return isinstance(value, int)
    return isinstance(value, bytes)


def check(kind: str, arguments: dict, organisation: str):
    """Refuse a proposal that could not take effect now. `organisation` is the one that proposes."""
    require(kind in FIELDS, "KIND_UNKNOWN", "The lifecycle knows no proposal of this kind.")
    fields = FIELDS[kind]
    require(len(arguments) == len(fields), "FIELDS_WRONG", "The proposal lacks a field, or has one too many.")
    for field, wanted in fields.items():
        known = field in arguments and is_of(arguments[field], wanted)
        require(known, "FIELDS_WRONG", f"The proposal needs the field {field} of type {wanted}.")
    name = arguments["name"]
    table = state.get(b"table")
    if kind == "keep":
        require(len(trials_of(name)) > 0, "NO_TRIAL", "No version of this contract is on trial.")
        require_active(arguments["version"], table[name])
        return
    check_when(arguments)
    if kind == "deploy":
        check_new_version(name, arguments["source_hash"], table, organisation)
        return
    require(name in table, "CONTRACT_UNKNOWN", "There is no contract of this name.")
    version, _, enabled, _ = table[name]
    if kind == "disable":
        require(name not in GOVERNING, "GOVERNING", "The network and the people in it cannot do without this contract.")
        require(enabled, "DISABLED_ALREADY", "The contract is disabled already.")
        require_active(arguments["version"], table[name])
        return
    known = 0 < arguments["version"] and arguments["version"] <= state.get(b"versions/" + name.encode(), 0)
    require(known, "VERSION_UNKNOWN", "The contract has no such version.")
    active = enabled and arguments["version"] == version
    require(not active, "ACTIVE_ALREADY", "This version is the active one.")


def require_active(version: int, row: list):
    """What is said of a version counts for no other that took its place meanwhile."""
    require(version == row[0], "VERSION_OTHER", f"The active version is {row[0]}, not {version}.")


def require_fresh(name: str, proposed_height: int):
    """What was proposed before the contract changed counts no more: it was meant for another contract than this one."""
    table, number = [state.get(b"table"), state.get(b"versions/" + name.encode(), 0)]
    changed_height = table[name][3] if name in table else 0
    if number > 0:
        changed_height = max(changed_height, state.get(version_key(name, number))["approved_height"])
    text = f"The contract changed at height {changed_height}, after this was proposed: withdraw it, and propose it again."
    require(changed_height <= proposed_height, "PROPOSAL_STALE", text)


def check_when(arguments: dict):
    known = 0 <= arguments["height"] and arguments["height"] <= ctx.height + AHEAD_MAX_BLOCKS
    require(known, "HEIGHT_WRONG", "The height is 0, or at most 10,000,000 blocks ahead.")
    known = 0 <= arguments["delay"] and arguments["delay"] <= AHEAD_MAX_BLOCKS
    require(known, "HEIGHT_WRONG", "The delay is 0 to 10,000,000 blocks.")
    require(len(arguments["note"]) <= NOTE_MAX_CHARS, "NOTE_WRONG", "A note has at most 280 characters.")
    for hidden in HIDDEN_IN_NOTES:
        require(hidden not in arguments["note"], "NOTE_WRONG", "A note is one line of characters that can be seen.")
    require(len(state.get(b"due", [])) < DUE_MAX_COUNT, "DUE_TOO_MANY", "Too many changes of contracts wait already.")


def check_new_version(name: str, source_hash: bytes, table: dict, organisation: str):
    if name not in table:
        coming = {entry["name"]: True for entry in state.get(b"due", []) if entry["name"] not in table}
        coming[name] = True
        require(len(table) + len(coming) <= CONTRACTS_MAX_COUNT, "CONTRACTS_TOO_MANY", "A network has at most 64 contracts.")
    else:
        require(table[name][1] != source_hash, "ACTIVE_ALREADY", "This source is the active version's.")
    number = state.get(b"versions/" + name.encode(), 0)
    require(number < VERSIONS_MAX_COUNT, "VERSIONS_TOO_MANY", "A contract has at most 1,000 versions.")
    facts = require_facts(organisation, source_hash)
    if name in GOVERNING:
        check_governing(name, facts, table[name][0])


def check_governing(name: str, facts: dict, active: int):
    """A contract that governs keeps every entry, and can be undone: so it must not write its state anew."""
    require(not facts["migrates"], "MIGRATION_REFUSED", "A contract that governs cannot migrate: it must be undoable.")
    kept = {entry[0]: entry for entry in facts["entries"]}
    for entry in state.get(version_key(name, active))["entries"]:
        same = entry[0] in kept and kept[entry[0]] == entry
        require(same, "ENTRY_LOST", f"The new version must keep the entry {entry[0]} with its parameters.")


def check_name(name: str):
    known = 0 < len(name) and len(name) <= NAME_MAX_CHARS and name not in RESERVED_NAMES
    require(known, "NAME_WRONG", "A contract's name has 1 to 32 characters, and is not reserved.")
    require(name[0] in NAME_CHARS[:26], "NAME_WRONG", "A contract's name begins with a small letter.")
    for character in name:
        require(character in NAME_CHARS, "NAME_WRONG", "A name is of small letters, digits, '-' and '_'.")


# What takes effect


def take_effect(proposal_id: bytes, kind: str, arguments: dict, organisation: str):
    name = arguments["name"]
    if kind == "keep":
        row = {"kind": kind, "name": name, "version": arguments["version"], "from_height": ctx.height + 1, "from_ms": 0}
        state.put(b"due", state.get(b"due", []) + [row])
        emit("kept", {"name": name})
        return
    if kind == "deploy":
        entry = find_upload(organisation, arguments["source_hash"])
        version = state.get(b"versions/" + name.encode(), 0) + 1
        facts = require_facts(organisation, entry["source_hash"])
        store_source(organisation, entry, facts["size_bytes"])
        record = new_version(facts, arguments["note"], organisation, proposal_id)
        state.put(version_key(name, version), record)
        state.put(b"versions/" + name.encode(), version)
        schedule("activate", name, version, arguments)
    elif kind == "activate":
        schedule("activate", name, arguments["version"], arguments)
    else:
        schedule("disable", name, state.get(b"table")[name][0], arguments)


def schedule(kind: str, name: str, version: int, arguments: dict):
    """Note what is due, at a height of its own: only one contract changes with a block.

    It takes the place of what else waits for this contract, but for a decision to keep a version.
    """
    due = [entry for entry in state.get(b"due", []) if entry["name"] != name or entry["kind"] == "keep"]
    height = max(arguments["height"], ctx.height + max(arguments["delay"], 1))
    taken = [entry["from_height"] for entry in due]
    while height in taken:
        height += 1
    due.append({"kind": kind, "name": name, "version": version, "from_height": height, "from_ms": 0})
    state.put(b"due", due)
    emit("scheduled", {"kind": kind, "name": name, "version": version, "height": height})


def trials_of(name: str) -> list:
    return [entry for entry in state.get(b"trials", []) if entry["name"] == name]


def read_changes() -> list:
    return state.get(b"due", []) + state.get(b"trials", [])


# What organisations decide


@export
def propose(kind: str, arguments: dict):
    """Propose to deploy, activate or disable a version, or to keep one; its proposer stands behind it.

    Who may call: an admin of an active organisation.
    """
    organisation = require_admin()
    if kind == "deploy":
        name, source_hash = [arguments.get("name"), arguments.get("source_hash")]
        known = isinstance(name, str) and isinstance(source_hash, bytes)
        require(known, "FIELDS_WRONG", "The proposal needs a name and a source hash.")
        check_name(name)
    check(kind, arguments, organisation)
    if call("membership", "propose_contract", kind, arguments):
        take_effect(ctx.txid, kind, arguments, organisation)


@export
def approve(proposal_id: bytes):
    """Stand behind a proposal; with a majority it takes effect. Who may call: an admin of an active organisation."""
    require_direct()
    reached, kind, arguments = call("membership", "approve_contract", proposal_id)
    proposal = call("membership", "proposal", proposal_id)
    require_fresh(arguments["name"], proposal["height"])
    if reached:
        organisation = proposal["organisation"]
        check(kind, arguments, organisation)
        take_effect(proposal_id, kind, arguments, organisation)


@view
def contracts() -> list:
    """Return [name, version, source hash, enabled, since height] of every contract, by name."""
    table = state.get(b"table")
    return [[name] + table[name] for name in sorted(table.keys())]


@view
def contract(name: str) -> dict | None:
    """Return {name, version, source_hash, enabled, since_height, versions, due} of a contract, or None."""
    table = state.get(b"table")
    versions = state.get(b"versions/" + name.encode(), 0)
    if versions == 0:
        return None
    version, source_hash, enabled, since_height = table.get(name, [0, b"", False, 0])
    row = {"name": name, "version": version, "source_hash": source_hash, "enabled": enabled}
    row.update({"since_height": since_height, "versions": versions})
    row["due"] = [entry for entry in read_changes() if entry["name"] == name]
    return row


@view
def version(name: str, number: int) -> dict | None:
    """Return what is known of a version, or None."""
    return state.get(version_key(name, number))


@view
def changes_due() -> list:
    """Return what waits for its height or time."""
    return read_changes()


@view
def uploads(organisation: str) -> list:
    """Return the sources that an organisation has uploaded and that nobody approved yet."""
    return read_uploads(organisation)

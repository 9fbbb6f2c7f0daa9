"""The organisations of the network and their nodes, as they decide together. Must never let one decide for the others.

A proposal takes effect in the block in which a majority of the active organisations stands behind it. Each organisation
has one voice, whichever of its admins speaks; a voice is good as long as the keys that gave it: who is added anew, or
gets new keys, has to speak again. What a proposal must look like is the contract `forms`'s to say. What it keeps: docs/reference/state.md.
"""

ID_BYTES = 32
ORGANISATIONS_MAX_COUNT = 32
NODES_MAX_COUNT = 64
NODES_OF_ONE_MAX_COUNT = 24
OPEN_MAX_COUNT = 160
OPEN_OF_ONE_MAX_COUNT = 4
EXPIRED_AT_ONCE_MAX_COUNT = 2
CLOSED_KEPT_MAX_COUNT = 32
PROPOSAL_LIFETIME_MS = 604800000


@genesis
def genesis(organisations: list, nodes: list):
    """Write the first organisations [[name, CA certificate]] and nodes [[name, organisation, host, ...]]."""
    names = []
    for name, ca_certificate in organisations:
        put_organisation(name, ca_certificate, "active")
        count_keys(name)
        names.append(name)
    state.put(b"organisations", sorted(names))
    names = []
    owned = {}
    for name, organisation, host, p2p_port, api_url, producer_key, producer_possession, custodian_key in nodes:
        entry = {"name": name, "organisation": organisation, "host": host, "p2p_port": p2p_port, "api_url": api_url}
        entry.update({"producer_key": producer_key, "producer_possession": producer_possession})
        entry["custodian_key"] = custodian_key
        put_node(entry)
        names.append(name)
        owned[organisation] = owned.get(organisation, []) + [name]
    state.put(b"nodes", sorted(names))
    for organisation, own in owned.items():
        state.put(b"nodes-of/" + organisation.encode(), sorted(own))


def put_organisation(name: str, ca_certificate: str, status: str):
    entry = {"name": name, "ca_certificate": ca_certificate, "status": status, "since_height": ctx.height}
    state.put(b"org/" + name.encode(), entry)


def keys_number(name: str) -> int:
    return state.get(b"keys-number/" + name.encode(), 0)


def count_keys(name: str):
    """The organisation gets keys: what was said with those before counts no more."""
    state.put(b"keys-number/" + name.encode(), keys_number(name) + 1)


def put_node(entry: dict):
    entry["status"] = "active"
    entry["since_height"] = ctx.height
    state.put(b"node/" + entry["name"].encode(), entry)
    for key in [entry["producer_key"], entry["custodian_key"]]:
        if len(key) > 0:
            state.put(b"key/" + key, entry["name"])


# What a proposal may ask for


def check(kind: str, arguments: dict):
    """Refuse a proposal that could not take effect now."""
    call("forms", "check", kind, arguments)
    if kind == "add_org":
        names = active_organisations()
        require(arguments["name"] not in names, "ORGANISATION_EXISTS", "There is an organisation of this name.")
        require(len(names) < ORGANISATIONS_MAX_COUNT, "ORGANISATIONS_TOO_MANY", "A network has at most 32 organisations.")
    elif kind == "remove_org":
        require_organisation(arguments["name"])
        check_others_govern(arguments["name"])
    elif kind == "replace_ca" or kind == "replace_keys":
        require_organisation(arguments["organisation"])
    elif kind == "revoke_certificate":
        require_organisation(arguments["organisation"])
        revoked = state.has(revocation_key(arguments))
        require(not revoked, "CERTIFICATE_REVOKED", "This certificate is revoked already.")
    elif kind == "add_node":
        check_new_node(arguments)
    elif kind == "remove_node":
        require_node(arguments["name"])
    elif kind == "move_node":
        was_safe = require_node(arguments["name"])["api_url"].startswith("https://")
        is_safe = arguments["api_url"].startswith("https://")
        require(is_safe or not was_safe, "URL_WRONG", "A node that clients reach over TLS stays so.")
    else:
        require_node(arguments["node"])
        check_new_key(arguments["producer_key"])


def revocation_key(arguments: dict) -> bytes:
    return b"revoked/" + arguments["organisation"].encode() + b"/" + arguments["serial"]


def require_organisation(name: str) -> dict:
    require(name in active_organisations(), "ORGANISATION_UNKNOWN", "There is no active organisation of this name.")
    return state.get(b"org/" + name.encode())


def require_node(name: str) -> dict:
    require(name in state.get(b"nodes"), "NODE_UNKNOWN", "There is no active node of this name.")
    return state.get(b"node/" + name.encode())


def check_others_govern(name: str):
    """Somebody must be left who can propose anything."""
    governed = False
    for other in active_organisations():
        if other != name and call("identity", "admin_count", other) > 0:
            governed = True
    require(governed, "LAST_ADMINS", "No other organisation has an admin; the network could never be changed again.")


def check_new_key(key: bytes):
    require(not state.has(b"key/" + key), "KEY_TAKEN", "A node has or had this key; each needs one of its own.")


def check_new_node(node: dict):
    require_organisation(node["organisation"])
    names = state.get(b"nodes")
    used = state.has(b"node/" + node["name"].encode())
    require(not used, "NODE_NAME_USED", "There is, or was, a node of this name; its certificates name it.")
    require(len(names) < NODES_MAX_COUNT, "NODES_TOO_MANY", "A network has at most 64 nodes.")
    own = state.get(nodes_of(node["organisation"]), [])
    require(len(own) < NODES_OF_ONE_MAX_COUNT, "NODES_TOO_MANY", "An organisation has at most 24 nodes.")
    for key in [node["producer_key"], node["custodian_key"]]:
        if len(key) > 0:
            check_new_key(key)


# What takes effect


def take_effect(kind: str, arguments: dict):
    if kind == "add_org":
        add_organisation(arguments)
    elif kind == "remove_org":
        remove_organisation(arguments["name"])
    elif kind == "replace_ca":
        put_organisation(arguments["organisation"], arguments["ca_certificate"], "active")
    elif kind == "replace_keys":
        name = arguments["organisation"]
        count_keys(name)
        call("identity", "put_organisation", name, arguments["admins"], arguments["registrars"])
        call("producers", "forget_voice", name)
    elif kind == "revoke_certificate":
        state.put(revocation_key(arguments), {"height": ctx.height})
    elif kind == "add_node":
        put_node(arguments)
        own = nodes_of(arguments["organisation"])
        state.put(b"nodes", sorted(state.get(b"nodes") + [arguments["name"]]))
        state.put(own, sorted(state.get(own, []) + [arguments["name"]]))
        if len(arguments["custodian_key"]) > 0:
            name = arguments["name"]
            call("identity", "add_custodian", arguments["custodian_key"], name, arguments["organisation"])
    elif kind == "remove_node":
        remove_nodes([require_node(arguments["name"])], "")
    elif kind == "move_node":
        entry = require_node(arguments["name"])
        entry.update(arguments)
        state.put(b"node/" + entry["name"].encode(), entry)
    else:
        rekey(arguments)


def nodes_of(organisation: str) -> bytes:
    return b"nodes-of/" + organisation.encode()


def add_organisation(arguments: dict):
    name = arguments["name"]
    put_organisation(name, arguments["ca_certificate"], "active")
    count_keys(name)
    state.put(b"organisations", sorted(active_organisations() + [name]))
    call("identity", "put_organisation", name, arguments["admins"], arguments["registrars"])


def remove_organisation(name: str):
    """An organisation goes with its nodes, its admins and its registrars, and its voice counts no more."""
    put_organisation(name, require_organisation(name)["ca_certificate"], "removed")
    state.put(b"organisations", [other for other in active_organisations() if other != name])
    call("identity", "remove_organisation", name)
    remove_nodes([state.get(b"node/" + node_name.encode()) for node_name in state.get(nodes_of(name), [])], name)


def remove_nodes(entries: list, leaving_organisation: str):
    """Take nodes of one organisation out, with what they produced and kept, and its votes if it leaves (else empty)."""
    leaving = [entry["name"] for entry in entries]
    custodian_keys = []
    producer_keys = []
    for entry in entries:
        entry["status"] = "removed"
        entry["since_height"] = ctx.height
        state.put(b"node/" + entry["name"].encode(), entry)
        if len(entry["custodian_key"]) > 0:
            custodian_keys.append(entry["custodian_key"])
        if len(entry["producer_key"]) > 0:
            producer_keys.append(entry["producer_key"])
    places = [b"nodes"]
    if len(entries) > 0:
        places.append(nodes_of(entries[0]["organisation"]))
    for place in places:
        state.put(place, [name for name in state.get(place) if name not in leaving])
    if len(custodian_keys) > 0:
        call("identity", "remove_custodians", custodian_keys)
    call("producers", "remove_keys", producer_keys, active_organisations(), leaving_organisation)


def rekey(arguments: dict):
    entry = require_node(arguments["node"])
    old = entry["producer_key"]
    entry["producer_key"] = arguments["producer_key"]
    entry["producer_possession"] = arguments["producer_possession"]
    put_node(entry)
    if len(old) > 0:
        call("producers", "rekey", old, arguments["producer_key"])


# Proposals


def require_direct():
    require(ctx.calling_contract == "", "CALL_INDIRECT", "Only a transaction does that, no other contract in its name.")


def require_admin() -> str:
    """Return the active organisation that the caller speaks for."""
    name = call("identity", "admin_of", ctx.caller)
    require(name != "", "NOT_AN_ADMIN", "Only an admin of an active organisation may do that.")
    return name


def close(proposal_id: bytes, proposal: dict, status: str):
    """Take a proposal from the open ones; the last 32 closed ones stay readable."""
    state.put(b"open", [other for other in state.get(b"open", []) if other[0] != proposal_id])
    proposal["status"] = status
    proposal["closed_height"] = ctx.height
    state.put(b"proposal/" + proposal_id, proposal)
    closed = state.get(b"closed", [])
    closed.append(proposal_id)
    if len(closed) > CLOSED_KEPT_MAX_COUNT:
        state.delete(b"proposal/" + closed[0])
        closed = closed[1:]
    state.put(b"closed", closed)


def make_room(organisation: str):
    """Close some of what has expired (a call's gas is bounded); refuse one proposal too many.

    There is room for all that 32 organisations may have open, so that no few of them can shut the others out.
    """
    own = 0
    count = 0
    expired = 0
    for proposal_id, proposer, expires_ms in state.get(b"open", []):
        if expires_ms <= ctx.time:
            expired += 1
            if expired <= EXPIRED_AT_ONCE_MAX_COUNT:
                close(proposal_id, state.get(b"proposal/" + proposal_id), "expired")
        else:
            count += 1
            if proposer == organisation:
                own += 1
    require(own < OPEN_OF_ONE_MAX_COUNT, "PROPOSALS_TOO_MANY", "An organisation has at most 4 open proposals.")
    require(count < OPEN_MAX_COUNT, "PROPOSALS_TOO_MANY", "There are at most 160 open proposals.")


def open_proposal(contract: str, kind: str, arguments: dict) -> bool:
    """Note a proposal with its proposer's voice. Tells whether it takes effect at once."""
    organisation = require_admin()
    make_room(organisation)
    proposal = {
        "contract": contract,
        "kind": kind,
        "arguments": arguments,
        "organisation": organisation,
        "approvals": [organisation],
        "keys_numbers": {organisation: keys_number(organisation)},
        "time": ctx.time,
        "expires_ms": ctx.time + PROPOSAL_LIFETIME_MS,
        "height": ctx.height,
        "status": "open",
        "closed_height": 0,
    }
    state.put(b"open", state.get(b"open", []) + [[ctx.txid, organisation, proposal["expires_ms"]]])
    state.put(b"proposal/" + ctx.txid, proposal)
    emit("proposed", {"proposal_id": ctx.txid, "contract": contract, "kind": kind, "organisation": organisation})
    return settle(ctx.txid, proposal)


def add_approval(contract: str, proposal_id: bytes) -> list:
    """Add the caller's voice. Returns [whether it takes effect now, kind, arguments]."""
    organisation = require_admin()
    proposal = require_open(proposal_id)
    require(proposal["contract"] == contract, "PROPOSAL_OF_ANOTHER", "The proposal is one of another contract.")
    voices = good_voices(proposal)
    require(organisation not in voices, "APPROVED_ALREADY", "The organisation has approved already; each has one voice.")
    proposal["approvals"] = voices + [organisation]
    proposal["keys_numbers"][organisation] = keys_number(organisation)
    state.put(b"proposal/" + proposal_id, proposal)
    emit("approved", {"proposal_id": proposal_id, "organisation": organisation})
    return [settle(proposal_id, proposal), proposal["kind"], proposal["arguments"]]


def require_open(proposal_id: bytes) -> dict:
    require(len(proposal_id) == ID_BYTES, "PROPOSAL_UNKNOWN", "A proposal's id has 32 bytes.")
    proposal = state.get(b"proposal/" + proposal_id)
    require(proposal is not None, "PROPOSAL_UNKNOWN", "There is no such proposal.")
    require(proposal["status"] == "open", "PROPOSAL_CLOSED", "The proposal is closed.")
    require(ctx.time < proposal["expires_ms"], "PROPOSAL_EXPIRED", "The proposal is more than seven days old.")
    return proposal


def good_voices(proposal: dict) -> list:
    """Return the active organisations behind a proposal whose keys are still those that they spoke with."""
    organisations = {name: True for name in active_organisations()}
    numbers = proposal["keys_numbers"]
    voices = [name for name in proposal["approvals"] if name in organisations]
    return [name for name in voices if numbers[name] == keys_number(name)]


def own_affair(kind: str, arguments: dict) -> str:
    """Return the organisation that decides alone, or an empty text."""
    if kind == "revoke_certificate":
        return arguments["organisation"]
    if kind == "move_node":
        return require_node(arguments["name"])["organisation"]
    return ""


def settle(proposal_id: bytes, proposal: dict) -> bool:
    own = own_affair(proposal["kind"], proposal["arguments"]) == proposal["organisation"]
    if len(good_voices(proposal)) < len(active_organisations()) // 2 + 1 and not own:
        return False
    close(proposal_id, proposal, "executed")
    emit("executed", {"proposal_id": proposal_id, "contract": proposal["contract"], "kind": proposal["kind"]})
    return True


@export
def propose(kind: str, arguments: dict):
    """Propose a change of membership; its proposer stands behind it. Who may call: an admin of an active organisation.

    An organisation revokes its own certificates, and moves its own nodes, without the others.
    """
    require_direct()
    require_admin()
    check(kind, arguments)
    if open_proposal("membership", kind, arguments):
        take_effect(kind, arguments)


@export
def approve(proposal_id: bytes):
    """Stand behind a proposal; with a majority it takes effect. Who may call: an admin of an active organisation."""
    require_direct()
    reached, kind, arguments = add_approval("membership", proposal_id)
    if reached:
        check(kind, arguments)
        take_effect(kind, arguments)


@export
def withdraw(proposal_id: bytes):
    """Take an open proposal of any contract back. Who may call: an admin of the organisation that proposed it."""
    require_direct()
    organisation = require_admin()
    proposal = require_open(proposal_id)
    require(proposal["organisation"] == organisation, "NOT_THE_PROPOSER", "Another organisation proposed it.")
    close(proposal_id, proposal, "withdrawn")
    emit("withdrawn", {"proposal_id": proposal_id})


@export
def propose_setting(name: str, value: int | str) -> bool:
    """Note a proposed setting. Tells whether it takes effect at once. Who may call: the contract `settings`."""
    require(ctx.calling_contract == "settings", "NOT_THE_SETTINGS_CONTRACT", "Only the contract settings may do that.")
    return open_proposal("settings", "set", {"name": name, "value": value})


@export
def approve_setting(proposal_id: bytes) -> list:
    """Add a voice for a setting. Returns [takes effect now, name, value]. Who may call: the contract `settings`."""
    require(ctx.calling_contract == "settings", "NOT_THE_SETTINGS_CONTRACT", "Only the contract settings may do that.")
    reached, kind, arguments = add_approval("settings", proposal_id)
    return [reached, arguments["name"], arguments["value"]]


@export
def propose_contract(kind: str, arguments: dict) -> bool:
    """Note a proposal about a contract. Tells whether it takes effect at once. Who may call: the contract `lifecycle`."""
    require(ctx.calling_contract == "lifecycle", "NOT_THE_LIFECYCLE_CONTRACT", "Only the contract lifecycle may do that.")
    return open_proposal("lifecycle", kind, arguments)


@export
def approve_contract(proposal_id: bytes) -> list:
    """Add a voice. Returns [takes effect now, kind, arguments]. Who may call: the contract `lifecycle`."""
    require(ctx.calling_contract == "lifecycle", "NOT_THE_LIFECYCLE_CONTRACT", "Only the contract lifecycle may do that.")
    return add_approval("lifecycle", proposal_id)


@view
def active_organisations() -> list:
    """Return the names of the active organisations, sorted."""
    return state.get(b"organisations")


@view
def electorate(key: bytes) -> list:
    """Return [the active organisation that the key is an admin of, or an empty text; all active organisations]."""
    return [call("identity", "admin_of", key), active_organisations()]


@view
def node_of_key(key: bytes) -> dict | None:
    """Return the active node whose producer key this is, or None."""
    name = state.get(b"key/" + key)
    if name is None:
        return None
    entry = state.get(b"node/" + name.encode())
    if entry["status"] != "active" or entry["producer_key"] != key:
        return None
    return entry


@view
def organisation(name: str) -> dict | None:
    """Return an organisation's state, or None."""
    return state.get(b"org/" + name.encode())


@view
def list_nodes() -> list:
    """Return the names of the active nodes, sorted."""
    return state.get(b"nodes")


@view
def proposals() -> list:
    """Return the open proposals as [id, proposer, expires_ms], oldest first."""
    return state.get(b"open", [])


@view
def proposal(proposal_id: bytes) -> dict | None:
    """Return a proposal's state, or None: the last 32 closed ones are kept."""
    return state.get(b"proposal/" + proposal_id)

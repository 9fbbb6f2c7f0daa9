"""Who is who: members, their handles and roles, organisations and custodians. Must never learn a tag's UID.

A handle is a random name that a registrar drew for a card. It is registered once, by whoever holds the card's one-time
key, under a registrar's voucher. What a member consents to is in the contract `consent` alone. What it keeps:
docs/reference/state.md.
"""

KEY_BYTES = 33
HANDLE_BYTES = 32
SHORT_HANDLE_BYTES = 10
SEALING_BYTES = 32
SIGNATURE_BYTES = 65
PURPOSES_MAX_COUNT = 16
ROLES = ("subject", "staff", "robot", "officer", "auditor")
RECORDED_ROLES = ("subject", "staff")
VOUCHER_TAG = "blockrobot/voucher"
CARD_TAG = "blockrobot/card"
ROTATION_TAG = "blockrobot/rotation"
ROBOT_NAME_MAX_CHARS = 32
ROBOT_PLACE_MAX_CHARS = 48
NOT_SEEN = "\x7f\u00a0\u00ad"
LAST_LATIN = "\u024f"
DAY_MS = 86400000
ROTATIONS_A_DAY_MAX_COUNT = 16
ROOM_MAX_GIB = 16777216


@genesis
def genesis(organisations: list, custodian_nodes: list, purposes: list):
    """Write the first state: [[name, admins, registrars]], [[key, name, org]] and purpose codes."""
    for name, admins, registrars in organisations:
        enter_organisation(name, admins, registrars)
    keys = []
    for key, name, org in custodian_nodes:
        state.put(b"custodian/" + key, {"name": name, "org": org})
        keys.append(key)
    state.put(b"custodians", sorted(keys))
    for code in purposes:
        state.put(b"purpose/" + code.encode(), True)


def enter_organisation(name: str, admins: list, registrars: list):
    """Write an organisation's keys; none of them may speak for another."""
    for kind, keys in [[b"admin/", admins], [b"registrar/", registrars]]:
        for key in keys:
            require(not state.has(kind + key), "KEY_OF_ANOTHER", "The key is an admin's or registrar's elsewhere.")
            state.put(kind + key, name)
    state.put(b"org/" + name.encode(), {"admins": admins, "registrars": registrars})


def forget_keys(name: str):
    known = state.get(b"org/" + name.encode())
    if known is not None:
        for admin in known["admins"]:
            state.delete(b"admin/" + admin)
        for registrar in known["registrars"]:
            state.delete(b"registrar/" + registrar)


def require_membership():
    require(ctx.calling_contract == "membership", "NOT_THE_MEMBERSHIP_CONTRACT", "Only the organisations may, together.")


@export
def put_organisation(name: str, admins: list, registrars: list):
    """Add an organisation, or put new keys in place of its own. Who may call: the contract `membership`."""
    require_membership()
    forget_keys(name)
    enter_organisation(name, admins, registrars)
    emit("organisation_changed", {"name": name})


@export
def remove_organisation(name: str):
    """End an organisation's rights; its robots and staff lose theirs with it. Who may call: the contract `membership`."""
    require_membership()
    forget_keys(name)
    state.put(b"org/" + name.encode(), {"admins": [], "registrars": []})
    state.put(b"removed/" + name.encode(), ctx.time)
    emit("organisation_removed", {"name": name})


@export
def add_custodian(key: bytes, name: str, org: str):
    """Add a custodian. Who may call: the contract `membership`."""
    require_membership()
    state.put(b"custodian/" + key, {"name": name, "org": org})
    state.put(b"custodians", sorted(custodians() + [key]))


@export
def remove_custodians(keys: list):
    """Remove custodians. Who may call: the contract `membership`."""
    require_membership()
    remaining = [key for key in custodians() if key not in keys]
    require(len(remaining) > 0, "LAST_CUSTODIAN", "Somebody must keep what is recorded: add a custodian first.")
    for key in keys:
        state.delete(b"custodian/" + key)
        state.delete(b"room/" + key)
    state.put(b"custodians", remaining)
    emit("custodians_removed", {"custodians": keys})


@export
def declare_room(gib: int):
    """Say how much room the caller has for clips, 0: not said; clips are shared out after it. Who may call: a custodian.

    Once a day, since each time the others work out anew what they keep.
    """
    require(ctx.calling_contract == "", "CALL_INDIRECT", "Only a transaction does that, no other contract in its name.")
    require(is_custodian(ctx.caller), "NOT_A_CUSTODIAN", "Only a custodian may do that.")
    require(0 <= gib and gib <= ROOM_MAX_GIB, "ROOM_WRONG", f"Room is 0 to {ROOM_MAX_GIB} GiB.")
    before = state.get(b"room/" + ctx.caller)
    is_due = before is None or ctx.time >= before["time"] + DAY_MS
    require(is_due, "ROOM_DECLARED_TODAY", "A custodian says once a day how much room it has.")
    state.put(b"room/" + ctx.caller, {"gib": gib, "time": ctx.time})
    emit("room_declared", {"custodian": ctx.caller, "gib": gib})


def check_keys(spend: bytes, view: bytes, sealing: bytes):
    require(len(spend) == KEY_BYTES and len(view) == KEY_BYTES, "KEY_SIZE_WRONG", "S and V have 33 bytes each.")
    require(len(sealing) == SEALING_BYTES, "KEY_SIZE_WRONG", "X has 32 bytes.")


def check_purposes(purposes: list):
    require(len(purposes) <= PURPOSES_MAX_COUNT, "PURPOSES_TOO_MANY", "A member consents to at most 16 purposes.")
    for code in purposes:
        require(isinstance(code, str) and purpose_known(code), "PURPOSE_UNKNOWN", "The purpose is not published.")


def require_member(handle: bytes) -> dict:
    """Return the caller's own state; they must be active and registered under this handle, and call directly."""
    require(ctx.calling_contract == "", "CALL_INDIRECT", "Only a transaction does that, no other contract in its name.")
    require(len(handle) == HANDLE_BYTES, "HANDLE_SIZE_WRONG", "A handle has 32 bytes.")
    owner = state.get(b"handle/" + handle)
    require(owner is not None, "HANDLE_UNKNOWN", "Nobody is registered under this handle.")
    require(owner == ctx.caller, "NOT_THE_MEMBER", "The caller is not registered under this handle.")
    entry = state.get(b"member/" + ctx.caller)
    require(entry is not None and entry["status"] == "active", "MEMBER_NOT_ACTIVE", "The member has left.")
    return entry


@export
def register(
    handle: bytes,
    card_key: bytes,
    role: str,
    not_after_ms: int,
    voucher_signature: bytes,
    spend: bytes,
    view: bytes,
    sealing: bytes,
    card_signature: bytes,
    purposes: list,
):
    """Register the caller under a handle. Who may call: whoever holds the card's key, under a registrar's voucher.

    The purposes are first consents, for those who can be recorded.
    """
    require(len(handle) == HANDLE_BYTES, "HANDLE_SIZE_WRONG", "A handle has 32 bytes.")
    require(len(card_key) == KEY_BYTES, "KEY_SIZE_WRONG", "A card key has 33 bytes.")
    check_keys(spend, view, sealing)
    require(role in ROLES, "ROLE_UNKNOWN", "There is no such role.")
    require(0 <= not_after_ms and not_after_ms < 9007199254740992, "VOUCHER_EXPIRED", "The expiry is out of range.")
    require(ctx.time <= not_after_ms, "VOUCHER_EXPIRED", "The voucher is too old; the registrar issues a new card.")
    voucher = ctx.chain + handle + card_key + u64(not_after_ms) + role.encode()
    registrar = recover(VOUCHER_TAG, voucher_signature, voucher)
    org = None
    if registrar is not None:
        org = state.get(b"registrar/" + registrar)
    require(org is not None, "NOT_A_REGISTRAR", "The voucher is not signed by a registrar for these fields.")
    card = ctx.chain + handle + ctx.caller + spend + view + sealing
    require(recover(CARD_TAG, card_signature, card) == card_key, "CARD_SIGNATURE_WRONG", "The card signed other keys.")
    short = b"short-handle/" + handle[:SHORT_HANDLE_BYTES]
    require(not state.has(short), "HANDLE_TAKEN", "The handle is registered already, or begins as one that is.")
    require(not state.has(b"member/" + ctx.caller), "MEMBER_EXISTS", "The key is registered already.")
    check_purposes(purposes)
    state.put(b"handle/" + handle, ctx.caller)
    state.put(short, handle)
    entry = {
        "handle": handle,
        "role": role,
        "org": org,
        "spend": spend,
        "view": view,
        "sealing": sealing,
        "status": "active",
        "since": ctx.time,
    }
    state.put(b"member/" + ctx.caller, entry)
    note_change()
    if len(purposes) > 0 and role in RECORDED_ROLES:
        call("consent", "begin", handle, purposes)
    emit("registered", {"member": ctx.caller, "role": role})


@export
def authenticate(handle: bytes):
    """Show on the chain that the caller's key is the handle's. Who may call: the member of the handle."""
    require_member(handle)
    emit("authenticated", {"member": ctx.caller})


@export
def rotate(handle: bytes, new_member: bytes, spend: bytes, view: bytes, sealing: bytes, new_member_signature: bytes):
    """Put new keys in place of the caller's. Who may call: the member of the handle, with the new key's agreement."""
    entry = require_member(handle)
    require(len(new_member) == KEY_BYTES, "KEY_SIZE_WRONG", "M has 33 bytes.")
    check_keys(spend, view, sealing)
    require(not state.has(b"member/" + new_member), "MEMBER_EXISTS", "The new key is registered already.")
    message = ctx.chain + handle + ctx.caller + new_member + spend + view + sealing
    signer = recover(ROTATION_TAG, new_member_signature, message)
    require(signer == new_member, "ROTATION_SIGNATURE_WRONG", "The new key did not sign this rotation.")
    today = ctx.time // DAY_MS
    day, count = state.get(b"rotations/" + handle, [today, 0])
    if day != today:
        count = 0
    require(count < ROTATIONS_A_DAY_MAX_COUNT, "WORDS_TOO_MANY", "A member changes keys 16 times a day.")
    state.put(b"rotations/" + handle, [today, count + 1])
    old = reduced(entry, "rotated")
    entry["spend"] = spend
    entry["view"] = view
    entry["sealing"] = sealing
    state.put(b"member/" + new_member, entry)
    state.put(b"handle/" + handle, new_member)
    state.put(b"member/" + ctx.caller, old)
    named = state.get(b"robot-name/" + ctx.caller)
    if named is not None:
        state.put(b"robot-name/" + new_member, named)
    note_change()
    emit("rotated", {"member": ctx.caller, "new_member": new_member})


@export
def leave(handle: bytes):
    """End the membership and remove its keys. Who may call: the member of the handle."""
    entry = require_member(handle)
    state.put(b"member/" + ctx.caller, reduced(entry, "left"))
    note_change()
    call("consent", "end", handle)
    emit("left", {"member": ctx.caller})


@export
def revoke(handle: bytes):
    """End another's membership (a stolen robot). Who may call: an admin or registrar of the member's organisation."""
    owner, entry = member_of_own_organisation(handle)
    state.put(b"member/" + owner, reduced(entry, "revoked"))
    note_change()
    call("consent", "end", handle)
    emit("revoked", {"member": owner})


def member_of_own_organisation(handle: bytes) -> list:
    """Return [key, state] of an active member; the caller must be an admin or registrar of its organisation."""
    require(ctx.calling_contract == "", "CALL_INDIRECT", "Only a transaction does that, no other contract in its name.")
    require(len(handle) == HANDLE_BYTES, "HANDLE_SIZE_WRONG", "A handle has 32 bytes.")
    owner = state.get(b"handle/" + handle)
    require(owner is not None, "HANDLE_UNKNOWN", "Nobody is registered under this handle.")
    entry = state.get(b"member/" + owner)
    require(entry["status"] == "active", "MEMBER_NOT_ACTIVE", "The member has left.")
    org = state.get(b"org/" + entry["org"].encode())
    entitled = ctx.caller in org["admins"] or ctx.caller in org["registrars"]
    require(entitled, "NOT_AN_ADMIN", "Only an admin or a registrar of the member's organisation may do that.")
    return [owner, entry]


@export
def name_robot(handle: bytes, name: str, place: str):
    """Say what people call a robot, and where it is. Who may call: an admin or registrar of the member's organisation."""
    robot, entry = member_of_own_organisation(handle)
    require(entry["role"] == "robot", "ROBOT_UNKNOWN", "Only robots have a public name; people never do.")
    require(0 < len(name), "ROBOT_NAME_WRONG", "A name has 1 to 32 characters.")
    check_words(name, ROBOT_NAME_MAX_CHARS)
    check_words(place, ROBOT_PLACE_MAX_CHARS)
    named = {"name": name, "place": place, "organisation": entry["org"], "time": ctx.time}
    state.put(b"robot-name/" + robot, named)
    emit("robot_named", {"member": robot, "name": name, "place": place})


def check_words(words: str, most: int):
    require(len(words) <= most, "ROBOT_NAME_WRONG", "A name has 1 to 32 characters, a place at most 48.")
    require(words == words.strip(), "ROBOT_NAME_WRONG", "A name and a place begin and end with no space.")
    for character in words:
        known = " " <= character and character <= LAST_LATIN and character not in NOT_SEEN
        known = known and not ("\x7f" < character and character < "\u00a0")
        require(known, "ROBOT_NAME_WRONG", "A name and a place are of Latin letters, digits and signs that can be seen.")


def note_change():
    """Robots ask for this one number to learn whether they must read the registry again."""
    state.put(b"changes", state.get(b"changes", 0) + 1)


def reduced(entry: dict, status: str) -> dict:
    """Return what is left of a member who is none any more: no keys to find or seal anything with."""
    return {
        "handle": entry["handle"],
        "role": entry["role"],
        "org": entry["org"],
        "spend": b"",
        "view": b"",
        "sealing": b"",
        "status": status,
        "since": ctx.time,
    }


@view
def member(m: bytes) -> dict | None:
    """Return a member's state, or None."""
    return state.get(b"member/" + m)


@view
def member_of_handle(handle: bytes) -> dict | None:
    """Return {member, ...state} of a handle, or None."""
    owner = state.get(b"handle/" + handle)
    if owner is None:
        return None
    found = state.get(b"member/" + owner)
    found["member"] = owner
    return found


@view
def robot_name(m: bytes) -> dict | None:
    """Return {name, place, organisation, time} of a robot, or None."""
    return state.get(b"robot-name/" + m)


@view
def role_of(m: bytes) -> str:
    """Return the role of an active member, or an empty text. Only subjects outlast their organisation.

    An organisation that is let in again begins anew: who was registered before that stays out.
    """
    found = state.get(b"member/" + m)
    if found is None or found["status"] != "active":
        return ""
    if found["role"] != "subject" and found["since"] <= state.get(b"removed/" + found["org"].encode(), -1):
        return ""
    return found["role"]


@view
def removed_ms(org: str) -> int:
    """Return when (ms) an organisation was last removed, or -1."""
    return state.get(b"removed/" + org.encode(), -1)


@view
def admin_of(key: bytes) -> str:
    """Return the organisation that the key is an admin of, or an empty text."""
    return state.get(b"admin/" + key, "")


@view
def admin_count(org: str) -> int:
    """Return how many admins an organisation has."""
    known = state.get(b"org/" + org.encode())
    if known is None:
        return 0
    return len(known["admins"])


@view
def is_custodian(m: bytes) -> bool:
    """Tell whether the key is a custodian's."""
    return state.has(b"custodian/" + m)


@view
def custodians() -> list:
    """Return the keys of all custodians, sorted."""
    return state.get(b"custodians", [])


@view
def purpose_known(code: str) -> bool:
    """Tell whether a purpose is on this network's list."""
    return 0 < len(code) and len(code) <= 32 and state.has(b"purpose/" + code.encode())

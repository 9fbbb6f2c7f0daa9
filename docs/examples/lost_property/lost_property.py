"""A register of lost property: what was found, who claims it, and who got it back.

A finder enters a thing with the hash of a mark that only its owner knows (an engraving, what is in the pocket). Who
claims it names the mark. The desk that keeps the thing hands it out to a claimant whose mark is right, or, when nobody
came for ninety days, to the finder.
"""

KEEP_MS = 90 * 24 * 3600 * 1000
KINDS = ["bag", "clothing", "device", "jewellery", "key", "other"]
OPEN_MAX_COUNT = 500


def find(number: int) -> dict:
    found = state.get(b"item/" + u64(number))
    require(found is not None, "ITEM_UNKNOWN", "There is no such thing in the register.")
    return found


@export
def enter(kind: str, where: str, mark_hash: bytes, finder: bytes) -> int:
    """Enter a thing that was brought to this desk; return its number."""
    require(kind in KINDS, "KIND_WRONG", "Things are: " + ", ".join(KINDS) + ".")
    require(0 < len(where) <= 120, "PLACE_WRONG", "Say in 1 to 120 characters where it was found.")
    require(len(mark_hash) == 32, "MARK_WRONG", "The mark is given as its hash, 32 bytes.")
    opened = state.get(b"open", 0)
    require(opened < OPEN_MAX_COUNT, "REGISTER_FULL", "Hand something out first.")
    number = state.get(b"last", 0) + 1
    state.put(b"last", number)
    state.put(b"open", opened + 1)
    thing = {
        "kind": kind,
        "where": where,
        "mark_hash": mark_hash,
        "finder": finder,
        "desk": ctx.caller,
        "entered": ctx.time,
        "claims": [],
        "given_to": b"",
    }
    state.put(b"item/" + u64(number), thing)
    state.put(b"kind/" + kind.encode() + b"/" + u64(number), True)
    emit("entered", {"number": number, "kind": kind, "where": where})
    return number


@export
def claim(number: int, mark: str) -> bool:
    """Claim a thing by its mark; tell whether the mark is right. Three wrong marks of one person are enough."""
    thing = find(number)
    require(thing["given_to"] == b"", "GIVEN_BACK", "That was given back already.")
    right = sha256(mark.encode()) == thing["mark_hash"]
    tries = sum([1 for claimant, was_right in thing["claims"] if claimant == ctx.caller and not was_right])
    require(tries < 3, "TRIED_ENOUGH", "Three wrong marks are enough; come to the desk.")
    thing["claims"].append([ctx.caller, right])
    state.put(b"item/" + u64(number), thing)
    emit("claimed", {"number": number, "by": ctx.caller, "right": right})
    return right


@export
def give_back(number: int, to: bytes):
    """Hand a thing out to who claimed it rightly, or after ninety days to its finder."""
    thing = find(number)
    require(thing["desk"] == ctx.caller, "OTHER_DESK", "The desk that keeps it hands it out.")
    require(thing["given_to"] == b"", "GIVEN_BACK", "That was given back already.")
    is_owner = any([claimant == to and right for claimant, right in thing["claims"]])
    is_late = ctx.time >= thing["entered"] + KEEP_MS and to == thing["finder"]
    require(is_owner or is_late, "NOT_THEIRS", "It goes to who named the mark, or after 90 days to who found it.")
    thing["given_to"] = to
    state.put(b"item/" + u64(number), thing)
    state.put(b"open", state.get(b"open") - 1)
    state.delete(b"kind/" + thing["kind"].encode() + b"/" + u64(number))
    emit("given_back", {"number": number, "to": to, "to_finder": not is_owner})


@view
def waiting(kind: str, limit: int) -> list[int]:
    """The numbers of the things of a kind that wait for their owner."""
    prefix = b"kind/" + kind.encode() + b"/"
    return [int.from_bytes(key[len(prefix) :]) for key, value in state.scan(prefix, limit)]


@view
def item(number: int) -> dict:
    return find(number)

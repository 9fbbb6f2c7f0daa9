"""A register of lost property: what was found, who claims it, and who got it back.

Everybody reads a chain, so what only the owner knows (an engraving, what is in the pocket) is on it as a hash with a
salt that the desk keeps. A claim is a hash too, over the mark, the claimant and a blind of theirs: it can neither be
read nor copied. At the desk both are opened; only if they are of the same mark the thing is handed out. If nobody came
for ninety days, its finder gets it.
"""

KEEP_MS = 90 * 24 * 3600 * 1000
KINDS = ["bag", "clothing", "device", "jewellery", "key", "other"]


def item_key(number: int) -> bytes:
    return b"item/" + u64(number)


def find(number: int) -> dict:
    require(number > 0, "ITEM_UNKNOWN", "Things are counted from 1.")
    found = state.get(item_key(number))
    require(found is not None, "ITEM_UNKNOWN", "There is no such thing in the register.")
    require(found["given_to"] == b"", "GIVEN_BACK", "That was given back already.")
    return found


def hand_out(number: int, thing: dict, to: bytes):
    require(thing["desk"] == ctx.caller, "OTHER_DESK", "The desk that keeps it hands it out.")
    thing["given_to"] = to
    state.put(item_key(number), thing)
    state.delete(b"kind/" + thing["kind"].encode() + b"/" + u64(number))
    emit("given_back", {"number": number, "to": to})


@export
def enter(kind: str, where: str, seal: bytes, finder: bytes) -> int:
    """Enter a thing that was brought to this desk, with the seal sha256(salt + mark); return its number."""
    require(kind in KINDS, "KIND_WRONG", "Things are: " + ", ".join(KINDS) + ".")
    require(0 < len(where) <= 120, "PLACE_WRONG", "Say in 1 to 120 characters where it was found.")
    require(len(seal) == 32, "SEAL_WRONG", "The mark is given as its seal, 32 bytes.")
    number = state.get(b"last", 0) + 1
    state.put(b"last", number)
    thing = {"kind": kind, "where": where, "seal": seal, "finder": finder, "desk": ctx.caller, "entered": ctx.time}
    thing["given_to"] = b""
    state.put(item_key(number), thing)
    state.put(b"kind/" + kind.encode() + b"/" + u64(number), True)
    emit("entered", {"number": number, "kind": kind, "where": where})
    return number


@export
def claim(number: int, answer: bytes):
    """Claim a thing with the answer sha256(blind + key + mark). One answer each: nobody guesses twice."""
    find(number)
    require(len(answer) == 32, "ANSWER_WRONG", "An answer has 32 bytes.")
    key = b"claim/" + u64(number) + ctx.caller
    require(not state.has(key), "CLAIMED_ALREADY", "Everybody has one answer.")
    state.put(key, answer)
    emit("claimed", {"number": number, "by": ctx.caller})


@export
def give_back(number: int, to: bytes, mark: str, salt: bytes, blind: bytes):
    """Hand a thing out to who claimed it with its mark: the desk opens its seal, the claimant the answer."""
    thing = find(number)
    require(len(salt) == 16 and len(blind) == 16, "OPENING_WRONG", "Salt and blind have 16 bytes each.")
    require(sha256(salt + mark.encode()) == thing["seal"], "MARK_WRONG", "That is not the mark that was sealed.")
    answer = state.get(b"claim/" + u64(number) + to)
    require(answer == sha256(blind + to + mark.encode()), "NOT_THEIRS", "Their answer was not this mark.")
    hand_out(number, thing, to)


@export
def give_to_finder(number: int):
    """Hand a thing out to who found it, ninety days after it was entered."""
    thing = find(number)
    require(ctx.time >= thing["entered"] + KEEP_MS, "TOO_EARLY", "Its owner has ninety days.")
    hand_out(number, thing, thing["finder"])


@view
def waiting(kind: str, limit: int) -> list[int]:
    """The numbers of the things of a kind that wait for their owner."""
    prefix = b"kind/" + kind.encode() + b"/"
    return [int.from_bytes(key[len(prefix) :]) for key, value in state.scan(prefix, limit)]


@view
def item(number: int) -> dict | None:
    """What is known of a thing, or None."""
    return state.get(item_key(number))

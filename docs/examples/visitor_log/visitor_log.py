"""Who is in the house: visitors sign in at a desk and out again; the log tells when and where to, never who.

A chain forgets nothing, so no name is on it. The desk hands out a numbered badge. A visitor is a hash over the name and
a secret that the desk draws for this visit and keeps: with both, the desk can show who came; without, nobody can guess.
"""

BADGES = 200


def badge_key(badge: int) -> bytes:
    require(0 < badge <= BADGES, "BADGE_UNKNOWN", f"The badges are 1 to {BADGES}.")
    return b"badge/" + u32(badge)


@export
def sign_in(badge: int, visitor: bytes, ward: str) -> int:
    """Note that somebody came, with which badge and to which ward; return the number of the visit."""
    key = badge_key(badge)
    require(len(visitor) == 32, "VISITOR_WRONG", "A visitor is named by a hash of 32 bytes.")
    require(0 < len(ward) <= 40, "WARD_WRONG", "A ward has 1 to 40 characters.")
    require(not state.has(key), "BADGE_TAKEN", "Somebody in the house has that badge.")
    number = state.get(b"last", 0) + 1
    state.put(b"last", number)
    state.put(key, number)
    visit = {"visitor": visitor, "badge": badge, "ward": ward, "desk": ctx.caller, "came": ctx.time, "left": 0}
    state.put(b"visit/" + u64(number), visit)
    emit("came", {"number": number, "ward": ward})
    return number


@export
def sign_out(badge: int) -> int:
    """Take a badge back; return how long the visit was, in minutes."""
    number = state.get(badge_key(badge))
    require(number is not None, "BADGE_FREE", "Nobody has that badge.")
    visit = state.get(b"visit/" + u64(number))
    require(visit["desk"] == ctx.caller, "OTHER_DESK", "The desk that signed somebody in signs them out.")
    visit["left"] = ctx.time
    state.put(b"visit/" + u64(number), visit)
    state.delete(badge_key(badge))
    minutes = (ctx.time - visit["came"]) // 60_000
    emit("left", {"number": number, "minutes": minutes})
    return minutes


@view
def present(ward: str) -> list[int]:
    """The badges that are out in a ward, for whoever has to find everybody in a fire."""
    numbers = [number for key, number in state.scan(b"badge/", BADGES)]
    visits = [state.get(b"visit/" + u64(number)) for number in numbers]
    return [visit["badge"] for visit in visits if visit["ward"] == ward]


@view
def visit(number: int) -> dict | None:
    """One visit, or None."""
    require(number > 0, "NUMBER_WRONG", "Visits are counted from 1.")
    return state.get(b"visit/" + u64(number))

"""Who is in the house: visitors sign in at a desk and out again; the log tells who was there when.

Any member of the network may run a desk. Only the desk that signed somebody in may sign that person out.
"""

NAME_MAX_CHARS = 80
PRESENT_MAX_COUNT = 200


def present_key(name: str) -> bytes:
    return b"present/" + sha256(name.encode())


@export
def sign_in(name: str, visits: str) -> int:
    """Note that somebody came, and whom they visit; return the number of the visit."""
    require(0 < len(name) <= NAME_MAX_CHARS, "NAME_WRONG", "A name has 1 to 80 characters.")
    require(0 < len(visits) <= NAME_MAX_CHARS, "NAME_WRONG", "Whom one visits has 1 to 80 characters.")
    key = present_key(name)
    require(not state.has(key), "ALREADY_IN", f"{name} is in the house already.")
    count = state.get(b"count", 0)
    require(count < PRESENT_MAX_COUNT, "HOUSE_FULL", "There are as many visitors as the house takes.")
    number = state.get(b"number", 0) + 1
    state.put(b"count", count + 1)
    state.put(b"number", number)
    state.put(key, number)
    visit = {"name": name, "visits": visits, "desk": ctx.caller, "came": ctx.time, "left": 0}
    state.put(b"visit/" + u64(number), visit)
    emit("came", {"number": number, "name": name})
    return number


@export
def sign_out(name: str) -> int:
    """Note that somebody left; return how long they stayed, in minutes."""
    number = state.get(present_key(name))
    require(number is not None, "NOT_IN", f"{name} is not in the house.")
    visit = state.get(b"visit/" + u64(number))
    require(visit["desk"] == ctx.caller, "OTHER_DESK", "The desk that signed somebody in signs them out.")
    visit["left"] = ctx.time
    state.put(b"visit/" + u64(number), visit)
    state.put(b"count", state.get(b"count") - 1)
    state.delete(present_key(name))
    minutes = (ctx.time - visit["came"]) // 60_000
    emit("left", {"number": number, "minutes": minutes})
    return minutes


@view
def present() -> list[str]:
    """The names of those who are in the house, by when they came."""
    numbers = sorted([number for key, number in state.scan(b"present/", 256)])
    return [state.get(b"visit/" + u64(number))["name"] for number in numbers]


@view
def visit(number: int) -> dict | None:
    """One visit, or None."""
    require(number > 0, "NUMBER_WRONG", "Visits are counted from 1.")
    return state.get(b"visit/" + u64(number))

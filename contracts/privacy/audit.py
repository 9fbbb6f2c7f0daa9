"""What happened to each visit, in order. Must never take a word but from the contracts that decide.

entry/O+n -> {record_id, kind, time, height, data}; count/O -> n. Counts are per visit, so visits never contend.
"""

WRITERS = ("records", "access", "erasure", "officers", "rights")
PAGE_MAX_COUNT = 128


@export
def append(owner: bytes, record_id: bytes, kind: str, data: dict):
    """Append one event of a visit. Who may call: the contracts that decide of visits."""
    require(ctx.calling_contract in WRITERS, "NOT_AN_AUDITED_CONTRACT", "Only the deciding contracts write the audit.")
    count = state.get(b"count/" + owner, 0)
    entry = {"record_id": record_id, "kind": kind, "time": ctx.time, "height": ctx.height, "data": data}
    state.put(b"entry/" + owner + u32(count), entry)
    state.put(b"count/" + owner, count + 1)


@view
def events(owner: bytes, first: int, limit: int) -> list:
    """Return at most 128 events of a visit from number `first` on, in order."""
    count = state.get(b"count/" + owner, 0)
    found = []
    for number in range(max(0, first), min(count, first + min(limit, PAGE_MAX_COUNT))):
        found.append(state.get(b"entry/" + owner + u32(number)))
    return found

"""What happened to each visit, in order. Must never take a word but from the contracts that decide.

Entries and counts are per visit, so visits never contend. What an owner, a grantee on a grant, or an officer may say
without end is counted by the day, so that no key makes a trail, or the state, grow as it likes. What ends something (an
erasure, a transfer, a revocation) and what others have to confirm is never refused here. What it keeps: docs/reference/state.md.
"""

WRITERS = ("records", "access", "erasure", "officers", "rights")
OWN_WORDS = ("access_requested", "granted", "objected", "restricted", "restriction_lifted", "verdict")
OFFICERS_WORDS = ("breach_assessed",)
OWNERS_WORDS_A_DAY_MAX_COUNT = 256
GRANTEES_WORDS_A_DAY_MAX_COUNT = 64
OFFICERS_WORDS_A_DAY_MAX_COUNT = 64
DAY_MS = 86400000
PAGE_MAX_COUNT = 128


def count_word(name: bytes, most: int):
    """Count one more of today's words of a visit or on a grant, for each contract apart; days are those of UTC."""
    key = b"day/" + ctx.calling_contract.encode() + b"/" + name
    today = ctx.time // DAY_MS
    day, count = state.get(key, [today, 0])
    if day != today:
        count = 0
    require(count < most, "WORDS_TOO_MANY", "A day takes 256 such words of a visit, and 64 on a grant.")
    state.put(key, [today, count + 1])


@export
def append(owner: bytes, record_id: bytes, kind: str, data: dict):
    """Append one event of a visit. Who may call: the contracts that decide of visits."""
    require(ctx.calling_contract in WRITERS, "NOT_AN_AUDITED_CONTRACT", "Only the deciding contracts write the audit.")
    if kind in OWN_WORDS and "grant" in data:
        count_word(data["grant"], GRANTEES_WORDS_A_DAY_MAX_COUNT)
    elif kind in OWN_WORDS:
        count_word(owner, OWNERS_WORDS_A_DAY_MAX_COUNT)
    elif kind in OFFICERS_WORDS:
        count_word(b"officers/" + owner, OFFICERS_WORDS_A_DAY_MAX_COUNT)
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

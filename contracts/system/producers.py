"""Who produces blocks, and by which settings. Must never leave the chain without a producer that leads.

epoch -> {number, producers, leaderless, settings, height}; candidate/key -> {name, organisation, votes, status,
ready_height, ready_ms, ready_root, suspended_height, evidence}; keys -> the candidates that are not removed.
"""


@genesis
def genesis(producers: list, organisations: list, settings: dict):
    """Write the first schedule: [[key, node, organisation]] in the order of turns, all organisations standing by it."""
    keys = []
    for key, name, organisation in producers:
        entry = {
            "name": name,
            "organisation": organisation,
            "votes": sorted(organisations),
            "status": "producing",
            "ready_height": 0,
            "ready_ms": 0,
            "ready_root": b"",
            "suspended_height": 0,
            "evidence": {},
        }
        state.put(b"candidate/" + key, entry)
        keys.append(key)
    state.put(b"keys", keys)
    state.put(b"epoch", {"number": 0, "producers": keys, "leaderless": [], "settings": settings, "height": 0})

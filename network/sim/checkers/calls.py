"""Checkers: what clients were told holds."""

from __future__ import annotations

from network.sim.history import Acknowledged, BlockFinalized, Ended, History, NodeRestored, NodeStarted, Violation


def check_exactly_once(history: History) -> list[Violation]:
    """Acknowledged transactions are on chain once, as reported; none twice."""
    found: list[Violation] = []
    places: dict[int, dict[bytes, int]] = {}
    acknowledged: dict[bytes, tuple[int, bytes]] = {}
    for item in history.observations:
        if item.node in history.byzantine:
            continue
        if isinstance(item, BlockFinalized) and item.stored:
            chain = places.setdefault(item.node, {})
            for txid in item.txids:
                if chain.setdefault(txid, item.height) != item.height or item.txids.count(txid) > 1:
                    text = f"transaction {txid.hex()[:8]} is in blocks {chain[txid]} and {item.height}"
                    found.append(Violation("exactly_once", item.at_ms, item.node, text))
        elif isinstance(item, Acknowledged):
            place = (item.height, item.block_id)
            if acknowledged.setdefault(item.txid, place) != place:
                text = f"transaction {item.txid.hex()[:8]} was said to be in two places"
                found.append(Violation("exactly_once", item.at_ms, item.node, text))
    ended = history.of(Ended)
    if ended and ended[-1].settled:
        left = {node: chain for node, chain in places.items() if node not in history.lost}
        found += _lost(left, acknowledged, ended[-1])
    return found


def _lost(
    places: dict[int, dict[bytes, int]], acknowledged: dict[bytes, tuple[int, bytes]], ended: Ended
) -> list[Violation]:
    return [
        Violation(
            "exactly_once", ended.at_ms, node, f"acknowledged transaction {txid.hex()[:8]} is not in block {height}"
        )
        for node, chain in places.items()
        for txid, (height, _) in acknowledged.items()
        if chain.get(txid) != height
    ]


def check_calls_succeed(history: History) -> list[Violation]:
    """Clients' legitimate calls succeed, or fail only as permitted."""
    return [
        Violation("calls_succeed", answer.at_ms, answer.node, f"call {answer.txid.hex()[:8]} failed with {answer.code}")
        for answer in history.of(Acknowledged)
        if answer.node not in history.byzantine and not answer.ok and answer.code not in answer.excused
    ]


def check_durability(history: History) -> list[Violation]:
    """Nothing durable or acknowledged is lost, even after a total power cut."""
    found: list[Violation] = []
    stored: dict[int, int] = {}
    put_back: dict[int, tuple[float, int]] = {}
    highest_told = 0
    for item in history.observations:
        if item.node in history.byzantine:
            continue
        if isinstance(item, BlockFinalized) and item.stored:
            stored[item.node] = max(stored.get(item.node, 0), item.height)
        elif isinstance(item, NodeRestored):
            put_back[item.node] = (item.at_ms, stored.get(item.node, 0))
            stored[item.node] = min(stored.get(item.node, 0), item.height)
        elif isinstance(item, NodeStarted):
            before = stored.get(item.node, 0)
            if item.height < before:
                text = f"block {before} was safe, and after the restart the ledger ends at {item.height}"
                found.append(Violation("durability", item.at_ms, item.node, text))
                stored[item.node] = item.height
        elif isinstance(item, Acknowledged):
            highest_told = max(highest_told, item.height)
            at_ms, before = put_back.get(item.node, (-1.0, 0))
            if item.height > (before if item.at_ms < at_ms else stored.get(item.node, 0)):
                text = f"a client was told of block {item.height} before it was safe"
                found.append(Violation("durability", item.at_ms, item.node, text))
    for ended in history.of(Ended):
        for node, height in enumerate(ended.heights):
            if node not in history.byzantine | history.lost and ended.settled and height < highest_told:
                text = f"a client was told of block {highest_told}, and in the end the ledger ends at {height}"
                found.append(Violation("durability", ended.at_ms, node, text))
    return found

"""Checker: acknowledged transactions are on chain once, as reported; none twice."""

from __future__ import annotations

from network.sim.checkers.violation import Violation
from network.sim.history import Acknowledged, BlockFinalized, Ended, History


def check_exactly_once(history: History) -> list[Violation]:
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
        found += _lost(places, acknowledged, ended[-1])
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

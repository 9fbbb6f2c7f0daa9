"""Checker: nothing durable or acknowledged is lost, even after a total power cut."""

from __future__ import annotations

from network.sim.checkers.violation import Violation
from network.sim.history import Acknowledged, BlockFinalized, Ended, History, NodeRestored, NodeStarted


def check_durability(history: History) -> list[Violation]:
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
            if node not in history.byzantine and ended.settled and height < highest_told:
                text = f"a client was told of block {highest_told}, and in the end the ledger ends at {height}"
                found.append(Violation("durability", ended.at_ms, node, text))
    return found

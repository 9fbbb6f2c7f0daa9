"""Checkers: final blocks, schedules and states are the same everywhere."""

from __future__ import annotations

from network.sim.history import (
    Acknowledged,
    BlockFinalized,
    EpochBegan,
    ExecutionDiffered,
    History,
    NodeStarted,
    ValueRead,
    Violation,
)


def check_agreement(history: History) -> list[Violation]:
    """One final block per height, one schedule per epoch."""
    epochs: dict[int, tuple[bytes, tuple[bytes, ...]]] = {}
    final: dict[int, bytes] = {}
    found: list[Violation] = []
    for item in history.observations:
        if isinstance(item, BlockFinalized | NodeStarted | Acknowledged) and item.node not in history.byzantine:
            known = final.setdefault(item.height, item.block_id)
            if known != item.block_id:
                text = f"two blocks are final at height {item.height}: {known.hex()[:8]} and {item.block_id.hex()[:8]}"
                found.append(Violation("agreement", item.at_ms, item.node, text))
        elif isinstance(item, EpochBegan) and item.node not in history.byzantine:
            beginning = (item.boundary, item.producers)
            if epochs.setdefault(item.epoch, beginning) != beginning:
                text = f"epoch {item.epoch} begins at another block or has other producers"
                found.append(Violation("agreement", item.at_ms, item.node, text))
    return found


def check_equal_state_roots(history: History) -> list[Violation]:
    """Equal states at equal heights, and equal client reads."""
    roots: dict[int, bytes] = {}
    values: dict[tuple[bytes, bytes], bytes] = {}
    found = [Violation("equal_state_roots", item.at_ms, item.node, item.text) for item in history.of(ExecutionDiffered)]
    for item in history.observations:
        if item.node in history.byzantine or not isinstance(item, BlockFinalized | NodeStarted | ValueRead):
            continue
        if roots.setdefault(item.height, item.state_root) != item.state_root:
            text = f"another state root after block {item.height}"
            found.append(Violation("equal_state_roots", item.at_ms, item.node, text))
        if isinstance(item, ValueRead):
            place = (item.state_root, item.key)
            if values.setdefault(place, item.digest) != item.digest:
                text = f"another value under {item.key!r} after block {item.height}"
                found.append(Violation("equal_state_roots", item.at_ms, item.node, text))
    return found

"""The figures that a node reads of itself whenever somebody asks for its metrics."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from node.components import Assembly


def gauges_of(parts: Assembly) -> dict[str, tuple[str, Callable[[], float]]]:
    """Return each figure's name, with what it says and how it is read; what only grows is named `_total`."""
    return {
        "blockrobot_finalized_height": ("Height of the newest stored block.", lambda: parts.feed.height),
        "blockrobot_round": ("The round that the node is in.", lambda: parts.core.round),
        "blockrobot_peers_connected": ("Connected peers.", lambda: len(parts.network.connected)),
        "blockrobot_mempool_transactions": ("Waiting transactions.", partial(len, parts.mempool)),
        "blockrobot_mempool_size_bytes": ("Bytes of waiting transactions.", lambda: parts.mempool.size_bytes),
        "blockrobot_mempool_evicted_total": (
            "Transactions that made room in a full pool for others of whom less waited.",
            lambda: parts.mempool.evicted_count,
        ),
        "blockrobot_signatures_checked_total": (
            "Signatures of transactions that this node checked as they came in.",
            lambda: parts.intake.signatures_checked_count,
        ),
        "blockrobot_transactions_dropped_total": (
            "Transactions that were refused or dropped because their source was over its budget.",
            lambda: parts.intake.dropped_count,
        ),
        "blockrobot_rounds_timed_out_total": (
            "Rounds that this node gave up since its start.",
            lambda: parts.engine.rounds_timed_out_count,
        ),
        **parts.executor.quarantine.gauges(),
        "blockrobot_signing": (
            "1 while the node takes part.",
            lambda: float(parts.engine.is_signing and parts.core.silence is None),
        ),
    }

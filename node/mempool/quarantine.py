"""Quarantine: failed or lost transactions stay out of own blocks, longer each time."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import structlog

from consensus.limits import TRANSACTION_LIFETIME_MAX_MS

PAUSES_MS = (10_000, 60_000, TRANSACTION_LIFETIME_MAX_MS)
"""How long a transaction is left out after its first, second and each further failure: longer than a new worker takes."""
LOST_PAUSES_MS = (5_000, 20_000, 60_000)
"""The same after own blocks that were not certified: mostly it was another transaction's doing, or a slow network's."""
HELD_MAX_COUNT = 4_096
CHANGES_MAX_COUNT = 64
FAILING_BLOCKS_MAX_COUNT = 64
REASON_MAX_CHARS = 200

Change = tuple[str, int]

log = structlog.get_logger(__name__)


@dataclass(slots=True)
class _Doubt:
    count: int = 0
    until_s: float = 0.0


class _Doubts:
    """Held transactions, longer each time; beyond `HELD_MAX_COUNT` the oldest is forgotten."""

    def __init__(self, pauses_ms: tuple[int, ...]) -> None:
        self._pauses_ms = pauses_ms
        self._held: OrderedDict[bytes, _Doubt] = OrderedDict()

    def add(self, txid: bytes, now_s: float) -> int:
        doubt = self._held.setdefault(txid, _Doubt())
        self._held.move_to_end(txid)
        doubt.count += 1
        doubt.until_s = now_s + self._pauses_ms[min(doubt.count, len(self._pauses_ms)) - 1] / 1000
        while len(self._held) > HELD_MAX_COUNT:
            self._held.popitem(last=False)
        return doubt.count

    def has(self, txid: bytes, now_s: float) -> bool:
        doubt = self._held.get(txid)
        return doubt is not None and doubt.until_s > now_s

    def current(self, now_s: float) -> set[bytes]:
        lifetime_s = TRANSACTION_LIFETIME_MAX_MS / 1000
        for txid in [txid for txid, doubt in self._held.items() if doubt.until_s + lifetime_s < now_s]:
            del self._held[txid]
        return {txid for txid, doubt in self._held.items() if doubt.until_s > now_s}


@dataclass(slots=True)
class _Failing:
    height: int
    attempts_count: int = 0
    certified: bool = False


class Quarantine:
    """The node's memory of failed executions; thread-safe, with a monotonic `stopwatch` (seconds)."""

    def __init__(self, stopwatch: Callable[[], float]) -> None:
        self._stopwatch = stopwatch
        self._lock = threading.Lock()
        self._failed = _Doubts(PAUSES_MS)
        self._lost = _Doubts(LOST_PAUSES_MS)  # apart: one lost block holds thousands, and pushes out no failure
        self._changes: OrderedDict[Change, float] = OrderedDict()
        self._blocks: OrderedDict[bytes, _Failing] = OrderedDict()
        self.failures_count = 0
        self.last_failure = ""

    # Transactions

    def note_failure(self, txid: bytes, reason: str) -> None:
        with self._lock:
            failures_count = self._failed.add(txid, self._stopwatch())
        self._note_reason(reason)
        log.error("transaction_quarantined", txid=txid.hex(), failures=failures_count, reason=self.last_failure)

    def note_lost(self, txids: Iterable[bytes]) -> None:
        with self._lock:
            for txid in txids:
                self._lost.add(txid, self._stopwatch())

    def held(self) -> frozenset[bytes]:
        with self._lock:
            now_s = self._stopwatch()
            return frozenset(self._failed.current(now_s) | self._lost.current(now_s))

    def find_failing(self, txids: Iterable[bytes]) -> bytes | None:
        """None if none failed recently."""
        with self._lock:
            now_s = self._stopwatch()
            return next((txid for txid in txids if self._failed.has(txid, now_s)), None)

    # Changes of contracts

    @property
    def has_failed_changes(self) -> bool:
        return bool(self._changes)

    def note_change(self, change: Change, reason: str) -> None:
        with self._lock:
            self._changes[change] = self._stopwatch() + TRANSACTION_LIFETIME_MAX_MS / 1000
            while len(self._changes) > CHANGES_MAX_COUNT:
                self._changes.popitem(last=False)
        self._note_reason(reason)
        log.error("change_failed_here", contract=change[0], version=change[1], reason=self.last_failure)

    def has_failed(self, change: Change) -> bool:
        with self._lock:
            return self._changes.get(change, 0.0) > self._stopwatch()

    # Blocks that others could execute

    def note_block(self, block_id: bytes, height: int, reason: str, *, certified: bool) -> None:
        """Note a block that failed here; its next execution may take more."""
        with self._lock:
            failing = self._blocks.pop(block_id, None) or _Failing(height)
            failing.attempts_count += 1
            failing.certified = failing.certified or certified
            self._blocks[block_id] = failing
            while len(self._blocks) > FAILING_BLOCKS_MAX_COUNT:
                self._blocks.popitem(last=False)
        self._note_reason(reason)

    def forget_block(self, block_id: bytes) -> None:
        with self._lock:
            self._blocks.pop(block_id, None)

    def failures_of(self, block_id: bytes) -> int:
        with self._lock:
            failing = self._blocks.get(block_id)
            return 0 if failing is None else failing.attempts_count

    def forget_up_to(self, height: int) -> None:
        with self._lock:
            for block_id in [block_id for block_id, one in self._blocks.items() if one.height <= height]:
                del self._blocks[block_id]

    def _note_reason(self, reason: str) -> None:
        self.failures_count += 1
        shown = (character if character.isascii() and character.isprintable() else "?" for character in reason)
        self.last_failure = "".join(shown)[:REASON_MAX_CHARS]

    def gauges(self) -> dict[str, tuple[str, Callable[[], float]]]:
        return {
            "blockrobot_execution_failures_total": (
                "Executions that failed since the start.",
                lambda: self.failures_count,
            ),
            "blockrobot_transactions_held": ("Transactions held back from own blocks.", lambda: len(self.held())),
        }

    def describe(self) -> dict[str, Any]:
        """Return holds and failures, for JSON. `stuck`: lowest block that others could execute."""
        held = len(self.held())
        with self._lock:
            certified = [failing for failing in self._blocks.values() if failing.certified]
            stuck = min(certified, key=lambda failing: failing.height, default=None)
        return {
            "held": held,
            "failures": self.failures_count,
            "last_failure": self.last_failure,
            "stuck": None if stuck is None else {"height": stuck.height, "attempts": stuck.attempts_count},
        }

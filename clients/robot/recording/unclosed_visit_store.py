"""Visits still to be closed, kept across crashes: encrypted owner keys and counts.

A clip is counted after spooling, saved before delivery; `recover_spooled` counts a missed one. Counts change on the event
loop; call `save` in a thread.
"""

from __future__ import annotations

import threading
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from clients.robot.identity.sealed_file import TEMPORARY_PREFIX, read_sealed, seal_content, write_durably
from clients.robot.recording.spool import Spool, number_of
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import Wire, decode, encode


class VisitCount(Wire, frozen=True):
    """A visit's owner key (33 bytes) and number of records."""

    owner: bytes
    record_count: int


class VisitCounts(Wire, frozen=True):
    """Visits, and the newest counted clip's number."""

    visits: tuple[VisitCount, ...]
    counted_up_to: int


@dataclass(frozen=True, slots=True)
class _Kept:
    counts: dict[bytes, int]
    counted_up_to: int


class UnclosedVisitStore:
    """One file; `inherited`: owner keys from earlier runs."""

    def __init__(self, path: Path, key: bytes) -> None:
        """Raises SPOOL_DAMAGED."""
        self._path = path
        self._key = key
        self._lock = threading.Lock()  # clips that are sealed, dropped and closed are saved in threads of their own
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        path.with_name(TEMPORARY_PREFIX + path.name).unlink(missing_ok=True)
        found = self._read()
        self._kept = _Kept({visit.owner: visit.record_count for visit in found.visits}, found.counted_up_to)
        self._saved = self._kept
        self._counts = dict(self._kept.counts)
        self._dropped: Counter[bytes] = Counter()
        self.inherited = frozenset(self._counts)

    def _read(self) -> VisitCounts:
        if not self._path.exists():
            return VisitCounts(visits=(), counted_up_to=0)
        try:
            return decode(read_sealed(self._path, self._key), VisitCounts)
        except BlockRobotError:
            raise BlockRobotError("SPOOL_DAMAGED", f"The list of open visits {self._path.name} was changed.") from None

    @property
    def counts(self) -> dict[bytes, int]:
        """Records per unclosed visit by owner key, oldest first, unspooled ones included."""
        return dict(self._counts)

    def recover_spooled(self, spool: Spool) -> None:
        """Before delivery, count and save clips spooled before a crash. Raises SPOOL_FULL."""
        names = spool.names()
        for name in names:
            if number_of(name) > self._kept.counted_up_to:
                with suppress(BlockRobotError):
                    owner = spool.get(name).owner
                    self._counts[owner] = self._counts.get(owner, 0) + 1
                    self.spooled(owner, name)
        self.inherited = frozenset(self._counts)
        self._kept = _Kept(self._kept.counts, number_of(names[-1]) if names else 0)
        self.save()

    def count(self, owner: bytes, sealed_count: int) -> None:
        """Set a visit's count; `sealed_count` includes clips that were destroyed since."""
        self._counts[owner] = sealed_count - self._dropped[owner]

    def spooled(self, owner: bytes, name: str) -> None:
        """Save before it is delivered."""
        self._keep(owner, self._kept.counts.get(owner, 0) + 1, number_of(name))

    def missed(self, owner: bytes) -> None:
        """A sealed clip is lost, and counts as missing."""
        self._keep(owner, self._kept.counts.get(owner, 0) + 1)

    def lower(self, owner: bytes) -> None:
        """Save after destruction."""
        if self._counts.get(owner, 0) > 0:
            self._dropped[owner] += 1
            self._counts[owner] -= 1
            self._keep(owner, max(0, self._kept.counts.get(owner, 0) - 1))

    def forget(self, owner: bytes) -> None:
        """Remove a visit that is closed on the chain; save afterwards."""
        self._counts.pop(owner, None)
        self._dropped.pop(owner, None)
        left = {other: count for other, count in self._kept.counts.items() if other != owner}
        self._kept = _Kept(left, self._kept.counted_up_to)

    def _keep(self, owner: bytes, count: int, number: int | None = None) -> None:
        before = self._kept
        self._kept = _Kept(before.counts | {owner: count}, before.counted_up_to if number is None else number)

    def save(self) -> None:
        """Write what changed; may be called from any thread. Raises SPOOL_FULL."""
        with self._lock:
            kept = self._kept
            if kept != self._saved:
                visits = tuple(VisitCount(owner=owner, record_count=count) for owner, count in kept.counts.items())
                content = encode(VisitCounts(visits=visits, counted_up_to=kept.counted_up_to))
                write_durably(self._path, seal_content(self._path.name, self._key, content))
                self._saved = kept

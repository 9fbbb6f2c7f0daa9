"""The visits that are still to be closed on the chain, kept over a kill.

Owner keys and counts alone, encrypted under the robot's spool key. A clip is counted here once it is in the spool, and
delivered once that is saved: killed in between, the robot finds one clip that it had not counted when it begins again
(`take_up`). So no record is on the chain that its visit does not count, and nothing is counted that never was anywhere.
Counts change on the event loop; `save`, which waits for the medium, is for a thread.
"""

from __future__ import annotations

import sys
import threading
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from clients.robot.recording.sealed_file import TEMPORARY_PREFIX, read_sealed, seal_content, write_durably
from clients.robot.recording.spool import Spool, number_of
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import Wire, decode, encode

_EVERY_CLIP = sys.maxsize


class VisitCount(Wire, frozen=True):
    """One visit: its owner key (33 bytes) and how many records it has."""

    owner: bytes
    record_count: int


class VisitCounts(Wire, frozen=True):
    """The file's content: the visits, and the number of the newest clip of the spool that is counted in them."""

    visits: tuple[VisitCount, ...]
    counted_up_to: int


class _FormerCounts(Wire, frozen=True):
    """The content of files of before that number: a clip was counted before it was spooled then."""

    visits: tuple[VisitCount, ...]


@dataclass(frozen=True, slots=True)
class _Kept:
    """What is to be on the medium, put in place whole: a thread that saves it sees no half of a change."""

    counts: dict[bytes, int]
    counted_up_to: int


class OpenVisits:
    """The counts of open visits in one file; what an earlier life of the robot left open is there on opening.

    `inherited` are the owner keys of those.
    """

    def __init__(self, path: Path, key: bytes) -> None:
        """Read the file, if there is one. Raises SPOOL_DAMAGED."""
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
            content = read_sealed(self._path, self._key)
            with suppress(BlockRobotError):
                return decode(content, VisitCounts)
            return VisitCounts(visits=decode(content, _FormerCounts).visits, counted_up_to=_EVERY_CLIP)
        except BlockRobotError:
            raise BlockRobotError("SPOOL_DAMAGED", f"The list of open visits {self._path.name} was changed.") from None

    @property
    def counts(self) -> dict[bytes, int]:
        """How many records each visit has that is not closed yet, by owner key, oldest visit first.

        With what is sealed, and on its way to the spool: a visit is not closed before.
        """
        return dict(self._counts)

    def take_up(self, spool: Spool) -> None:
        """Count what a robot that was killed had spooled and not counted, and save it; before anything is delivered.

        A clip that cannot be read is told of at its delivery. Raises SPOOL_FULL.
        """
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
        """Say that so many clips of a visit are sealed, the destroyed ones included."""
        self._counts[owner] = sealed_count - self._dropped[owner]

    def spooled(self, owner: bytes, name: str) -> None:
        """Say that a clip of a visit is in the spool, on the medium, under this name. To be saved before its delivery."""
        self._keep(owner, self._kept.counts.get(owner, 0) + 1, number_of(name))

    def missed(self, owner: bytes) -> None:
        """Say that a sealed clip will never be in the spool: it counts as missing, and its owner is told so."""
        self._keep(owner, self._kept.counts.get(owner, 0) + 1)

    def lower(self, owner: bytes) -> None:
        """Say that a record of the visit, if it is still open, will never be. To be saved after its clip is destroyed."""
        if self._counts.get(owner, 0) > 0:
            self._dropped[owner] += 1
            self._counts[owner] -= 1
            self._keep(owner, max(0, self._kept.counts.get(owner, 0) - 1))

    def forget(self, owner: bytes) -> None:
        """Say that the visit is closed on the chain. To be saved once it is."""
        self._counts.pop(owner, None)
        self._dropped.pop(owner, None)
        left = {other: count for other, count in self._kept.counts.items() if other != owner}
        self._kept = _Kept(left, self._kept.counted_up_to)

    def _keep(self, owner: bytes, count: int, number: int | None = None) -> None:
        before = self._kept
        self._kept = _Kept(before.counts | {owner: count}, before.counted_up_to if number is None else number)

    def save(self) -> None:
        """Remember the counts of what is spooled durably, unless they are; from any thread. Raises SPOOL_FULL."""
        with self._lock:
            kept = self._kept
            if kept != self._saved:
                visits = tuple(VisitCount(owner=owner, record_count=count) for owner, count in kept.counts.items())
                content = encode(VisitCounts(visits=visits, counted_up_to=kept.counted_up_to))
                write_durably(self._path, seal_content(self._path.name, self._key, content))
                self._saved = kept

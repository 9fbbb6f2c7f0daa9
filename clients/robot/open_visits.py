"""The visits that are still to be closed on the chain, kept over a kill. Must never tell whose a visit is.

Owner keys and counts alone, encrypted under the robot's spool key. A count is noted before its clip is spooled: a clip
that was lost between the two counts as missing, and the owner is told so. Counts change in memory; `save`, which waits
for the medium, is for a thread.
"""

from __future__ import annotations

import threading
from collections import Counter
from pathlib import Path

from clients.robot.sealed_file import TEMPORARY_PREFIX, read_sealed, seal_content, write_durably
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import Wire, decode, encode


class VisitCount(Wire, frozen=True):
    """One visit: its owner key (33 bytes) and how many records it has."""

    owner: bytes
    record_count: int


class VisitCounts(Wire, frozen=True):
    """The file's content."""

    visits: tuple[VisitCount, ...]


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
        self._counts = {visit.owner: visit.record_count for visit in self._read()}
        self._saved = dict(self._counts)
        self._dropped: Counter[bytes] = Counter()
        self.inherited = frozenset(self._counts)

    def _read(self) -> tuple[VisitCount, ...]:
        if not self._path.exists():
            return ()
        try:
            return decode(read_sealed(self._path, self._key), VisitCounts).visits
        except BlockRobotError:
            raise BlockRobotError("SPOOL_DAMAGED", f"The list of open visits {self._path.name} was changed.") from None

    @property
    def counts(self) -> dict[bytes, int]:
        """How many records each visit has that is not closed yet, by owner key, oldest visit first."""
        return dict(self._counts)

    def note(self, owner: bytes, sealed_count: int) -> None:
        """Remember durably that so many clips of a visit are sealed. Raises SPOOL_FULL."""
        self.count(owner, sealed_count)
        self.save()

    def count(self, owner: bytes, sealed_count: int) -> None:
        """Say that so many clips of a visit are sealed, the destroyed ones included. To be saved before the last is."""
        self._counts[owner] = sealed_count - self._dropped[owner]

    def lower(self, owner: bytes) -> None:
        """Say that a record of the visit, if it is still open, will never be. To be saved after its clip is destroyed."""
        if self._counts.get(owner, 0) > 0:
            self._dropped[owner] += 1
            self._counts[owner] -= 1

    def forget(self, owner: bytes) -> None:
        """Say that the visit is closed on the chain. To be saved once it is."""
        self._counts.pop(owner, None)
        self._dropped.pop(owner, None)

    def save(self) -> None:
        """Remember the counts durably, unless they are; from any thread. Raises SPOOL_FULL."""
        with self._lock:
            counts = self.counts
            if counts != self._saved:
                visits = tuple(VisitCount(owner=owner, record_count=count) for owner, count in counts.items())
                sealed = seal_content(self._path.name, self._key, encode(VisitCounts(visits=visits)))
                write_durably(self._path, sealed)
                self._saved = counts

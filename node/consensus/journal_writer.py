"""Journals records before messages leave, and waits out disk failures.

After a failure the journal is rewritten each second until it succeeds; meanwhile the engine stops (R38).
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor as ThreadExecutor
from typing import Protocol

import structlog

from consensus.errors import BlockRobotError

RETRY_MS = 1_000
INLINE_SYNC_MAX_MS = 1.0
SYNC_AVERAGED_COUNT = 16
COMPACT_ABOVE_BYTES = 4 * 1024 * 1024

log = structlog.get_logger(__name__)


class VotingJournal(Protocol):
    """Where records go before a message is sent."""

    def append(self, record: bytes, kind: int = 0) -> int:
        """Durable only after `sync`."""
        ...

    def sync(self) -> int:
        """Raises JOURNAL_UNWRITABLE: then send nothing."""
        ...

    def compact(self, keep: Iterable[tuple[int, bytes]], *, through: int | None = None) -> None: ...

    def recover(self, keep: Iterable[tuple[int, bytes]]) -> None:
        """After a failure, write these records into a new file. Raises JOURNAL_UNWRITABLE."""
        ...

    @property
    def size_bytes(self) -> int: ...


class JournalWriter:
    """The engine's journal; event loop only, except `sync`."""

    def __init__(
        self,
        journal: VotingJournal,
        *,
        stopwatch: Callable[[], float],
        snapshot: Callable[[], Sequence[bytes]],
        on_outage: Callable[[str], None],
        on_recovery: Callable[[], None],
    ) -> None:
        """`snapshot` returns all records the journal needs; called while nothing changes."""
        self._journal = journal
        self._stopwatch = stopwatch
        self._snapshot = snapshot
        self._on_outage, self._on_recovery = on_outage, on_recovery
        self._loop = asyncio.get_running_loop()
        self._newest_sequence: int | None = None
        self._sync_ms = 0.0
        self._refusal = ""
        self._thread: ThreadExecutor | None = None
        self._timer: asyncio.TimerHandle | None = None
        self._recovering: asyncio.Future[str] | None = None
        self._stopped = False

    def start(self, thread: ThreadExecutor | None) -> None:
        self._thread = thread

    async def stop(self) -> None:
        self._stopped = True
        if self._timer is not None:
            self._timer.cancel()
        if self._recovering is not None:
            await asyncio.wait([self._recovering])

    @property
    def is_fast(self) -> bool:
        return self._sync_ms <= INLINE_SYNC_MAX_MS

    def append(self, records: Iterable[bytes]) -> bool:
        """Append records; return whether accepted (then `sync` and `complete_sync`)."""
        try:
            for record in records:
                self._newest_sequence = self._journal.append(record)
        except BlockRobotError as error:
            self._begin_outage(error.detail)
            return False
        return True

    def sync(self) -> None:
        """Sync in any thread; `complete_sync` then handles the result."""
        started = self._stopwatch()
        try:
            self._journal.sync()
        except BlockRobotError as error:
            self._refusal = error.detail
        taken_ms = (self._stopwatch() - started) * 1000
        self._sync_ms += (taken_ms - self._sync_ms) / SYNC_AVERAGED_COUNT

    def complete_sync(self) -> None:
        if self._refusal:
            self._begin_outage(self._refusal)

    def compact(self) -> None:
        if self._journal.size_bytes >= COMPACT_ABOVE_BYTES:
            self.rewrite()

    def rewrite(self) -> None:
        """Replace the journal by its snapshot, under new sequences. Only between events.

        The snapshot covers all records appended so far (`through`).
        """
        if self._timer is not None or self._recovering is not None:
            return
        try:
            self._journal.compact([(0, record) for record in self._snapshot()], through=self._newest_sequence)
            self._newest_sequence = None
        except BlockRobotError as error:
            self._begin_outage(error.detail)

    # Outages

    def _begin_outage(self, reason: str) -> None:
        self._refusal = ""
        self._on_outage(reason)
        self._wait()

    def _wait(self) -> None:
        if not self._stopped:
            self._timer = self._loop.call_later(RETRY_MS / 1000, self._retry)

    def _retry(self) -> None:
        self._timer = None
        records = [(0, record) for record in self._snapshot()]
        self._recovering = self._loop.run_in_executor(self._thread, self._recover, records)
        self._recovering.add_done_callback(self._conclude)

    def _recover(self, records: list[tuple[int, bytes]]) -> str:
        try:
            self._journal.recover(records)
        except BlockRobotError as error:
            return error.detail
        return ""

    def _conclude(self, done: asyncio.Future[str]) -> None:
        self._recovering = None
        if done.cancelled() or self._stopped:
            return
        if done.result():
            self._wait()
        else:
            self._newest_sequence = None
            log.warning("journal_recovered")
            self._on_recovery()

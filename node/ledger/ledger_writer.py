"""Writes finalized blocks in order, and notifies waiters once they are durable."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from functools import partial

import structlog

from consensus.chain.block import FinalityProof
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode
from node.execution.block_executor import ExecutedBlock
from node.storage.ledger_store import LedgerSnapshot, LedgerStore, Position

COMMIT_BLOCKS_MAX_COUNT = 64
RETRY_MS = 1_000

log = structlog.get_logger(__name__)

FinalizedListener = Callable[[list[ExecutedBlock], FinalityProof, Position], None]


class FinalityFeed:
    """Waiters for heights and transactions, notified in arrival order; on the event loop."""

    def __init__(self, height: int) -> None:
        self.height = height
        self._heights: dict[asyncio.Future[None], None] = {}
        self._transactions: dict[bytes, dict[asyncio.Future[bool], None]] = {}

    def publish(self, blocks: list[ExecutedBlock], _proof: FinalityProof, position: Position) -> None:
        self.height = position.height
        for waiter in self._heights:
            if not waiter.done():
                waiter.set_result(None)
        self._heights.clear()
        if self._transactions:
            for block in blocks:
                for txid in sorted(block.txids):
                    self._resolve(txid, final=True)

    def give_up(self, txids: list[bytes]) -> None:
        for txid in txids:
            self._resolve(txid, final=False)

    def _resolve(self, txid: bytes, *, final: bool) -> None:
        for waiter in self._transactions.pop(txid, ()):
            if not waiter.done():
                waiter.set_result(final)

    async def wait_above(self, height: int, timeout_ms: int) -> bool:
        try:
            async with asyncio.timeout(timeout_ms / 1000):
                while self.height <= height:
                    waiter = asyncio.get_running_loop().create_future()
                    self._heights[waiter] = None
                    try:
                        await waiter
                    finally:
                        self._heights.pop(waiter, None)
        except TimeoutError:
            return False
        return True

    async def wait_final(self, txid: bytes, timeout_ms: int) -> bool:
        waiter = asyncio.get_running_loop().create_future()
        self._transactions.setdefault(txid, {})[waiter] = None
        try:
            async with asyncio.timeout(timeout_ms / 1000):
                final: bool = await waiter
                return final
        except TimeoutError:
            return False
        finally:
            waiters = self._transactions.get(txid)
            if waiters is not None:
                waiters.pop(waiter, None)
                if not waiters:
                    del self._transactions[txid]


class LedgerWriter:
    """Stores finalized blocks in batches, in order; a refusing store is retried every second (R38)."""

    def __init__(self, ledger: LedgerStore) -> None:
        self._ledger = ledger
        self._listeners: list[FinalizedListener] = []
        self._waiting: list[tuple[ExecutedBlock, FinalityProof]] = []
        self._unpublished: deque[LedgerSnapshot | None] = deque()
        self._stored: LedgerSnapshot | None = None
        self._wake = asyncio.Event()
        self._idle = asyncio.Event()
        self._idle.set()
        self._failed = False
        self._is_broken = False
        self._task: asyncio.Task[None] | None = None
        self._milestone = 0
        self._on_milestone: Callable[[LedgerSnapshot], None] | None = None
        position = ledger.position
        self.queued_height = -1 if position is None else position.height

    def add_listener(self, listener: FinalizedListener) -> None:
        """Called with the blocks of each commit, once they are durable."""
        self._listeners.append(listener)

    def set_milestones(self, every: int, hook: Callable[[LedgerSnapshot], None]) -> None:
        """Call `hook` with the ledger at each multiple of `every`; it owns the snapshot."""
        self._milestone, self._on_milestone = every, hook

    def start(
        self,
        *,
        on_failure: Callable[[str], None],
        on_recovery: Callable[[], None],
        between_events: Callable[[Callable[[], None]], None],
    ) -> None:
        """Begin to write; `between_events` calls listeners while nothing executes.

        `on_failure` gets the first refusal, `on_recovery` its end; unforeseen errors need a restart.
        """
        self._on_failure, self._on_recovery, self._between_events = on_failure, on_recovery, between_events
        self._task = asyncio.get_running_loop().create_task(self._run(), name="ledger-writer")
        self._task.add_done_callback(self._end)

    async def stop(self) -> None:
        """Pending blocks are written, unless the store refuses."""
        if self._task is None:
            return
        if not self._failed and not self._task.done():
            await self._idle.wait()
        self._task.cancel()
        await asyncio.gather(self._task, return_exceptions=True)
        while self._unpublished:
            _close(self._unpublished.popleft())

    def take_stored(self) -> LedgerSnapshot | None:
        """Return the ledger as running listeners know it; None after the first caller."""
        stored, self._stored = self._stored, None
        return stored

    def store(self, blocks: list[ExecutedBlock], proof: FinalityProof) -> None:
        """Queue finalized blocks, oldest first; skip those queued or stored already."""
        for block in blocks:
            if block.header.height == self.queued_height + 1:
                self.queued_height += 1
                self._waiting.append((block, proof))
            elif block.header.height > self.queued_height:
                raise AssertionError(f"block {block.header.height} comes after {self.queued_height}")
        if self._waiting:
            self._idle.clear()
            self._wake.set()

    async def _run(self) -> None:
        while True:
            await self._wake.wait()
            self._wake.clear()
            while self._waiting:
                batch = self._take_batch()
                blocks = [block for block, _ in batch]
                position = await self._commit(batch)
                self._unpublished.append(self._open_stored())
                del self._waiting[: len(batch)]
                self._pass_milestone(position.height)
                if not self._waiting:
                    self._idle.set()
                self._between_events(partial(self._publish, blocks, batch[-1][1], position))

    def _open_stored(self) -> LedgerSnapshot | None:
        try:
            return self._ledger.snapshot()
        except BlockRobotError as error:
            log.warning("stored_unreadable", code=error.code, detail=error.detail)
            return None

    def _pass_milestone(self, height: int) -> None:
        if self._on_milestone is None or height % self._milestone != 0:
            return
        try:
            self._on_milestone(self._ledger.snapshot())
        except BlockRobotError as error:
            log.error("milestone_failed", height=height, code=error.code, detail=error.detail)

    def _end(self, task: asyncio.Task[None]) -> None:
        """The writer ended unexpectedly: nothing is stored, so nothing may be signed."""
        error = None if task.cancelled() else task.exception()
        if error is not None:
            self._idle.set()
            self._break(error)

    def _break(self, error: BaseException) -> None:
        log.critical("ledger_writer_broken", exc_info=error)
        if not self._is_broken:
            self._is_broken = True
            self._on_failure(f"What was finalized cannot be stored or told: {type(error).__name__}. Restart the node.")

    async def _commit(self, batch: list[tuple[ExecutedBlock, FinalityProof]]) -> Position:
        stored = [block.to_stored(proof) for block, proof in batch]
        finality = encode(batch[-1][1])
        while True:
            try:
                position = await self._ledger.commit(stored, finality)
            except (BlockRobotError, OSError, ValueError) as error:
                if not self._failed:
                    self._failed = True
                    log.critical("ledger_failed", detail=str(error))
                    self._on_failure(f"The ledger cannot be written: {error}")
                self._idle.set()
                await asyncio.sleep(RETRY_MS / 1000)
                continue
            if self._failed:
                self._failed = False
                log.warning("ledger_recovered", height=position.height)
                if not self._is_broken:
                    self._on_recovery()
            return position

    def _publish(self, blocks: list[ExecutedBlock], proof: FinalityProof, position: Position) -> None:
        """Raises nothing."""
        self._stored = self._unpublished.popleft()
        try:
            for listener in self._listeners:
                listener(blocks, proof, position)
        except Exception as error:  # noqa: BLE001 - whatever it is: some have heard of the blocks and some have not
            self._break(error)
        finally:
            _close(self.take_stored())

    def _take_batch(self) -> list[tuple[ExecutedBlock, FinalityProof]]:
        end = min(len(self._waiting), COMMIT_BLOCKS_MAX_COUNT)
        for place, (block, _) in enumerate(self._waiting[:end], start=1):
            if block.next_epoch is not None:
                return self._waiting[: self._end_at_milestone(place)]
        while end < len(self._waiting) and self._waiting[end][1] is self._waiting[end - 1][1]:
            end += 1
        return self._waiting[: self._end_at_milestone(end)]

    def _end_at_milestone(self, end: int) -> int:
        """Return the batch end that passes no milestone with its own proof."""
        first = self._waiting[0][0].header.height
        for place in range(1, end):
            has_own_proof = self._waiting[place][1] is not self._waiting[place - 1][1]
            if self._milestone and has_own_proof and (first + place - 1) % self._milestone == 0:
                return place
        return end


def _close(snapshot: LedgerSnapshot | None) -> None:
    if snapshot is not None:
        snapshot.close()

"""Catching up: fetches finalized blocks from several peers, checks and executes them."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import Protocol, TypeVar

import structlog

from consensus.chain.block import Block, FinalityProof
from consensus.chain.genesis import Genesis
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode, encode
from contracts.execution.results import ExecutionFault
from node.consensus.engine import Engine
from node.execution.block_executor import Executor
from node.ledger.ledger_writer import FinalityFeed, LedgerWriter
from node.p2p.wire import BlockBatch, FinalizedRequest, RequestKind
from node.storage.ledger_store import LedgerStore, Position
from node.sync.batch_execution import CatchUp
from node.sync.block_ranges import CheckedRange, check_range, decode_range

LAG_TOLERATED_BLOCKS = 32
RANGE_COUNT = 64
RANGES_AHEAD_COUNT = 6
INLINE_WEIGHT_MAX = 48
UNSTORED_MAX_COUNT = 4 * RANGE_COUNT
STANDSTILL_MS = 2_000
PATIENCE_MS = 3_000
RETRY_MS = 500
RETRY_STEPS_MAX_COUNT = 60
FRUITLESS_MS = 5_000
DISTRUST_MS = 60_000
INSTALL_TIMEOUT_MS = 30_000

T = TypeVar("T")

log = structlog.get_logger(__name__)


class Requester(Protocol):
    """Asks peers."""

    async def request(self, peer: str, kind: RequestKind, body: bytes) -> bytes:
        """Raises PEER_UNAVAILABLE."""
        ...


@dataclass(slots=True)
class _Ask:
    from_height: int
    count: int
    task: asyncio.Task[CheckedRange | None]


class Synchroniser:
    """Keeps a node that is far behind catching up until it is not."""

    def __init__(
        self,
        *,
        genesis: Genesis,
        ledger: LedgerStore,
        engine: Engine,
        executor: Executor,
        writer: LedgerWriter,
        feed: FinalityFeed,
        requester: Requester,
    ) -> None:
        self._genesis = genesis
        self._ledger = ledger
        self._engine = engine
        self._executor = executor
        self._writer = writer
        self._feed = feed
        self._requester = requester
        self._heights: dict[str, int] = {}
        self._epochs: dict[str, int] = {}
        self._fruitless: dict[str, float] = {}
        self._distrusted: dict[str, float] = {}
        self._asked: dict[str, int] = {}
        self._block_s: dict[str, float] = {}  # how long each took for a block, by its last answer
        self._earliest: dict[str, int] = {}
        self._has_proof = False
        self._still: tuple[int, float] | None = None
        self._task: asyncio.Task[None] | None = None
        self._checking = ThreadPoolExecutor(max_workers=1, thread_name_prefix="sync-check")
        self.blocks_installed_count = 0

    @property
    def is_running(self) -> bool:
        return self._task is not None and not self._task.done()

    @property
    def closes_gap(self) -> bool:
        return self.is_running and self._has_proof

    @property
    def lag_blocks(self) -> int:
        """Blocks behind the highest height that peers claim (0 or more)."""
        return max(0, max(self._heights.values(), default=0) - self._writer.queued_height)

    def is_level_with(self, peer: str) -> bool:
        height = self._heights.get(peer)
        return height is not None and height <= self._writer.queued_height

    def snapshot_peers(self, lag_max: int) -> tuple[list[str], int]:
        """Return peers to fetch a snapshot from (empty while blocks suffice), and its minimum height.

        `lag_max`: how far ahead a peer may be (0: unlimited).
        """
        following = self._writer.queued_height + 1
        ahead = [peer for peer, height in self._heights.items() if height > following + LAG_TOLERATED_BLOCKS]
        pruned = [peer for peer in ahead if self._earliest.get(peer, 0) > following]
        if pruned and len(pruned) == len(ahead):
            return sorted(ahead), self.position.height
        too_far = bool(lag_max) and self.lag_blocks > lag_max
        return (sorted(ahead) if too_far else []), self.position.height + lag_max

    @property
    def position(self) -> Position:
        position = self._ledger.position
        if position is None:
            raise AssertionError("the ledger holds genesis")
        return position

    def peers_with_block(self, height: int) -> list[str]:
        return sorted(
            peer for peer, earliest in self._earliest.items() if earliest <= height <= self._heights.get(peer, -1)
        )

    def note_height(self, peer: str, height: int, earliest_height: int | None = None) -> None:
        """Note a peer's height and oldest body; catch up if far ahead."""
        if self._is_distrusted(peer):
            return
        self._heights[peer] = height
        if earliest_height is not None:
            self._earliest[peer] = earliest_height
        if height > self._writer.queued_height + LAG_TOLERATED_BLOCKS:
            self._begin()

    def recheck(self) -> None:
        """Close a short gap that stayed `STANDSTILL_MS`; call periodically."""
        reached = self._writer.queued_height
        if not self.lag_blocks:
            self._still = None
        elif self._still is None or self._still[0] != reached:
            self._still = (reached, self._now())
        elif self._now() >= self._still[1] + STANDSTILL_MS / 1000:
            self._still = None
            self._begin()

    def note_epoch(self, peer: str, epoch: int) -> None:
        """Catch up with a peer in a later epoch, unless it recently had nothing."""
        until = self._fruitless.get(peer)
        if self._is_distrusted(peer) or epoch <= self._engine.epoch.number:
            return
        if until is None or self._now() >= until:
            self._epochs[peer] = epoch
            self._begin()

    def _begin(self) -> None:
        if not self.is_running:
            self._has_proof = False
            self._task = asyncio.get_running_loop().create_task(self._run(), name="sync")

    def forget(self, peer: str) -> None:
        self._heights.pop(peer, None)
        self._epochs.pop(peer, None)
        self._earliest.pop(peer, None)

    def _now(self) -> float:
        return asyncio.get_running_loop().time()

    def _is_distrusted(self, peer: str) -> bool:
        return self._distrusted.get(peer, 0.0) > self._now()

    def _set_aside(self, peer: str) -> None:
        self.forget(peer)
        self._fruitless[peer] = self._now() + FRUITLESS_MS / 1000

    def _distrust(self, peer: str) -> None:
        self._set_aside(peer)
        self._distrusted[peer] = self._now() + DISTRUST_MS / 1000

    async def stop(self) -> None:
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)
        self._checking.shutdown(wait=True)

    # The work

    def _is_behind(self) -> bool:
        reached = max(self._feed.height, self._writer.queued_height)
        following = self._writer.queued_height + 1
        later = any(number > self._engine.epoch.number for number in self._epochs.values())
        useful = (height for peer, height in self._heights.items() if self._earliest.get(peer, 0) <= following)
        return later or any(height > reached for height in useful)

    async def _run(self) -> None:
        log.info("sync_started", height=self._writer.queued_height)
        failures_count = 0
        while self._is_behind():
            reached = self._writer.queued_height
            try:
                await self._catch_up()
            except BlockRobotError as error:
                log.warning("sync_failed", code=error.code, detail=error.detail)
            except ExecutionFault as error:
                failures_count += 1
                log.error("sync_block_not_executed", height=reached + 1, reason=error.reason)  # R41: again, with more
            if self._writer.queued_height == reached:
                self._has_proof = False  # what was proved is here; of what is still claimed nothing is
                await asyncio.sleep(RETRY_MS * (1 + min(failures_count, RETRY_STEPS_MAX_COUNT)) / 1000)
            else:
                failures_count = 0
        log.info("sync_finished", height=self._feed.height, blocks=self.blocks_installed_count)

    async def _catch_up(self) -> None:
        if self._feed.height < self._writer.queued_height:
            await self._feed.wait_above(self._writer.queued_height - 1, INSTALL_TIMEOUT_MS)
        work = CatchUp(self._ledger, self._executor)
        line: deque[_Ask] = deque()
        try:
            while True:
                self._lengthen(line, work.height)
                if not line:
                    break
                ask = line.popleft()
                run = await ask.task
                if run is None:
                    break
                await self._install(work, run)
                if run.ends_epoch:
                    break
                if line and run.last.header.height < ask.from_height + ask.count - 1:
                    _cancel(line)
        finally:
            _cancel(line)
            work.close()
        await self._wait_stored(self._writer.queued_height)

    def _lengthen(self, line: deque[_Ask], height: int) -> None:
        following = line[-1].from_height + line[-1].count if line else height + 1
        top = max(self._heights.values(), default=0)
        while len(line) < RANGES_AHEAD_COUNT and (following <= top or (not line and self._is_behind())):
            task = asyncio.get_running_loop().create_task(self._fetch(following, RANGE_COUNT))
            line.append(_Ask(following, RANGE_COUNT, task))
            following += RANGE_COUNT

    def _choose_peer(self, height: int, tried: set[str]) -> str | None:
        epoch = self._engine.epoch.number
        able = [
            peer
            for peer in sorted(self._heights.keys() | self._epochs.keys())
            if peer not in tried
            and (self._heights.get(peer, 0) >= height or self._epochs.get(peer, 0) > epoch)
            and self._earliest.get(peer, 0) <= height
        ]
        fastest_s = min((self._block_s[peer] for peer in able if peer in self._block_s), default=0.0)

        def expected(peer: str) -> tuple[float, int, int, str]:
            asked = self._asked.get(peer, 0)
            return (asked + 1) * self._block_s.get(peer, fastest_s), asked, -self._heights.get(peer, 0), peer

        return min(able, key=expected, default=None)

    async def _fetch(self, from_height: int, count: int) -> CheckedRange | None:
        tried: set[str] = set()
        while (peer := self._choose_peer(from_height, tried)) is not None:
            tried.add(peer)
            self._asked[peer] = self._asked.get(peer, 0) + 1
            try:
                found = await self._fetch_from(peer, from_height, count)
            except BlockRobotError as error:
                log.warning("sync_peer_failed", peer=peer, code=error.code, detail=error.detail)
                if error.code == "PEER_UNAVAILABLE":
                    self._set_aside(peer)
                else:
                    self._distrust(peer)
                continue
            finally:
                self._asked[peer] -= 1
            if found is not None:
                return found
        return None

    async def _fetch_from(self, peer: str, from_height: int, count: int) -> CheckedRange | None:
        """Raises PEER_UNAVAILABLE."""
        request = encode(FinalizedRequest(from_height=from_height, count=count))
        begun_s = self._now()
        try:
            async with asyncio.timeout(PATIENCE_MS / 1000):
                answer = await self._requester.request(peer, RequestKind.FINALIZED, request)
        except TimeoutError:
            raise BlockRobotError("PEER_UNAVAILABLE", f"{peer} did not answer in time.") from None
        batch = decode(answer, BlockBatch)
        blocks = decode_range(batch)
        if not blocks or batch.proof is None:
            self._note_nothing(peer, batch.earliest_height, from_height)
            return None
        self._block_s[peer] = (self._now() - begun_s) / len(blocks)
        if blocks[0].header.epoch != self._engine.epoch.number:
            if from_height == self._writer.queued_height + 1:
                self._set_aside(peer)
            return None  # an epoch ended here meanwhile, or ends before this run: no reason for distrust
        return await self._check(peer, blocks, batch.proof, from_height)

    def _note_nothing(self, peer: str, earliest_height: int, from_height: int) -> None:
        height = self._heights.get(peer, 0)
        if from_height == self._writer.queued_height + 1:
            self._set_aside(peer)
        if earliest_height > from_height:
            self._heights[peer], self._earliest[peer] = height, earliest_height
        elif self._heights.get(peer, 0) >= from_height:
            self._heights[peer] = from_height - 1

    async def _check(self, peer: str, blocks: list[Block], proof: FinalityProof, from_height: int) -> CheckedRange:
        start, chain_id, read = self._engine.epoch, self._genesis.chain_id, self._executor.read_transaction

        def check() -> CheckedRange:
            checked = check_range(blocks, proof, from_height=from_height, start=start, chain_id=chain_id, read=read)
            return CheckedRange(peer, checked, proof)

        return await _work(self._checking, check, sum(1 + len(block.transactions) for block in blocks))

    async def _install(self, work: CatchUp, run: CheckedRange) -> None:
        self._has_proof = True
        weight = sum(1 + len(checked.transactions) for checked in run.blocks)
        try:
            if self._executor.waits:
                weight = max(weight, INLINE_WEIGHT_MAX + 1)
            executed = await _work(self._executor.thread, partial(work.execute, run), weight)
        except BlockRobotError:
            self._distrust(run.peer)
            raise
        fresh = [block for block in executed if block.header.height > self._writer.queued_height]
        self._writer.store(fresh, run.proof)
        self.blocks_installed_count += len(fresh)
        await self._wait_stored(work.height if run.ends_epoch else work.height - UNSTORED_MAX_COUNT)

    async def _wait_stored(self, height: int) -> None:
        """Raises STORAGE_UNWRITABLE."""
        if self._feed.height < height and not await self._feed.wait_above(height - 1, INSTALL_TIMEOUT_MS):
            raise BlockRobotError("STORAGE_UNWRITABLE", "The ledger did not take the blocks in time.")


async def _work(thread: ThreadPoolExecutor, action: Callable[[], T], weight: int) -> T:
    if weight <= INLINE_WEIGHT_MAX:
        return action()
    return await asyncio.get_running_loop().run_in_executor(thread, action)


def _cancel(line: deque[_Ask]) -> None:
    for ask in line:
        ask.task.cancel()
    line.clear()

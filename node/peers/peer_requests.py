"""Answers peers' requests, few at a time; over budget they wait, then fail."""

from __future__ import annotations

import asyncio
from collections import OrderedDict
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from consensus.chain.block import Block
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode, encode
from node.limits.token_buckets import Allowance, Source, TokenBuckets, over_budget
from node.limits.work_costs import bytes_cost_us
from node.p2p.frame_costs import REQUEST_COSTS
from node.p2p.wire import BlockBatch, BranchRequest, FinalizedRequest, RequestKind
from node.storage.ledger_store import LedgerStore
from node.sync.block_ranges import read_range

REQUEST_ALLOWANCE = Allowance(us_per_s=100_000, burst_us=250_000)
WAIT_MAX_S = 1.5
SENDING_FACTOR = 4
"""A byte of an answer is read, encoded, encrypted and sent, which takes so much longer than to receive one."""
OF_BLOCKS = frozenset({RequestKind.BRANCH, RequestKind.FINALIZED})
"""One of these at a time for each peer: one thread reads them all."""
OTHERS_AT_ONCE_COUNT = 4
BRANCH_MAX_BYTES = 4 * 1024 * 1024
BRANCH_STORED_MAX_COUNT = 128
ANSWERS_KEPT_MAX_BYTES = 16 * 1024 * 1024
ANSWER_OVERHEAD_BYTES = 512  # what an answer takes in memory besides, were it empty


@dataclass(frozen=True, slots=True)
class _Kept:
    answer: bytes
    height: int
    is_full: bool

    @property
    def size_bytes(self) -> int:
        return len(self.answer) + ANSWER_OVERHEAD_BYTES


class PeerRequests:
    """Requests of all peers; on the event loop except for reading."""

    def __init__(self, ledger: LedgerStore, on_over_budget: Callable[[str, BlockRobotError], None]) -> None:
        self._ledger = ledger
        self._on_over_budget = on_over_budget
        self._loop = asyncio.get_running_loop()
        self._budgets: TokenBuckets[str] = TokenBuckets(lambda _peer: REQUEST_ALLOWANCE, self._loop.time)
        self._turns: dict[tuple[str, bool], asyncio.Semaphore] = {}
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="answers")
        self._kept: OrderedDict[FinalizedRequest, _Kept] = OrderedDict()
        self._kept_bytes = 0
        self._dropped_below = 0

    def stop(self) -> None:
        self._thread.shutdown(wait=True, cancel_futures=True)

    async def answer(self, peer: str, kind: RequestKind, make: Callable[[], Awaitable[bytes]]) -> bytes:
        """Answer in the peer's turn and budget. Raises RATE_LIMITED, or as `make`."""
        of_blocks = kind in OF_BLOCKS
        turn = self._turns.setdefault((peer, of_blocks), asyncio.Semaphore(1 if of_blocks else OTHERS_AT_ONCE_COUNT))
        async with turn:
            cost_us = REQUEST_COSTS[kind]
            wait_s = self._budgets.wait_s(peer, cost_us)
            if wait_s > WAIT_MAX_S:
                who = str(Source("peer", peer))
                error = over_budget(who, wait_s)
                self._on_over_budget(who, error)
                raise error
            if wait_s > 0:
                await asyncio.sleep(wait_s)
            self._budgets.charge(peer, cost_us)
            answer = await make()
            self._budgets.charge(peer, SENDING_FACTOR * bytes_cost_us(len(answer)))
            return answer

    # Blocks

    async def read_finalized(self, request: FinalizedRequest) -> bytes:
        """Cached briefly. Raises STORAGE_*."""
        position = self._ledger.position
        kept = self._kept.get(request)
        if kept is not None and position is not None and (kept.is_full or kept.height == position.height):
            self._kept.move_to_end(request)
            return kept.answer
        found = await self._loop.run_in_executor(self._thread, self._read_finalized, request)
        self._keep(request, found)
        return found.answer

    def forget_below(self, height: int) -> None:
        self._dropped_below = height
        for request in [request for request in self._kept if request.from_height < height]:
            self._drop(request)

    def _read_finalized(self, request: FinalizedRequest) -> _Kept:
        with self._ledger.snapshot() as snapshot:
            height = -1 if snapshot.position is None else snapshot.position.height
            batch = read_range(snapshot, max(1, request.from_height), request.count)
            is_full = len(batch.blocks) >= request.count > 0
            return _Kept(encode(batch), height, is_full)

    def _keep(self, request: FinalizedRequest, found: _Kept) -> None:
        if request.from_height < self._dropped_below:
            return  # it may have been read just before
        self._drop(request)
        self._kept[request] = found
        self._kept_bytes += found.size_bytes
        while self._kept_bytes > ANSWERS_KEPT_MAX_BYTES:
            self._drop(next(iter(self._kept)))

    def _drop(self, request: FinalizedRequest) -> None:
        gone = self._kept.pop(request, None)
        self._kept_bytes -= 0 if gone is None else gone.size_bytes

    async def read_branch(self, request: BranchRequest, branch: list[bytes]) -> bytes:
        """Return a branch, oldest first, completed from the ledger. Raises STORAGE_*."""
        return await self._loop.run_in_executor(self._thread, self._read_branch, request, branch)

    def _read_branch(self, request: BranchRequest, branch: list[bytes]) -> bytes:
        lowest = decode(branch[0], Block).header.height if branch else 0
        with self._ledger.snapshot() as snapshot:
            if not branch:
                lowest = (snapshot.block_height(request.block_id) or -1) + 1
            first = max(request.above_height + 1, lowest - BRANCH_STORED_MAX_COUNT, 1)
            stored = [data for _, data in snapshot.iter_blocks(first, lowest - first)] if lowest > first else []
        kept: list[bytes] = []
        size = 0
        for data in reversed(stored + branch):
            size += len(data)
            if kept and size > BRANCH_MAX_BYTES:
                break
            kept.append(data)
        return encode(BlockBatch(blocks=tuple(reversed(kept)), proof=None))

"""In-memory ledger for the simulator, with slow syncs and lossy power cuts."""

from __future__ import annotations

import asyncio
import random
from collections import deque
from collections.abc import Callable, Coroutine, Iterator, Sequence

from consensus.errors import BlockRobotError
from network.sim.world.cpu import COSTS, charge
from network.sim.world.virtual_time import SimLoop
from node.storage.ledger_store import FinalizedBlock, Position
from node.storage.memory_store import MemorySnapshot, MemoryStore

KIB = 1024

CommitListener = Callable[[Sequence[FinalizedBlock]], None]


class SimSnapshot(MemorySnapshot):
    """A snapshot whose block reads are charged to the node."""

    def iter_blocks(self, from_height: int, limit: int) -> Iterator[tuple[int, bytes]]:
        for height, data in super().iter_blocks(from_height, limit):
            charge(COSTS.range_kib * len(data) / KIB)
            yield height, data


class SimLedger:
    """A `LedgerStore` that outlives its node's lives; `cut_power` ends one."""

    def __init__(
        self, loop: SimLoop, dice: random.Random, on_handed: CommitListener, on_durable: CommitListener
    ) -> None:
        self.sync_max_ms = 4.0
        self.is_full = False
        self.before_commit: Callable[[], None] = _nothing
        self._loop = loop
        self._dice = dice
        self._on_handed, self._on_durable = on_handed, on_durable
        self._inner = MemoryStore()
        self._open: list[MemorySnapshot] = []
        self._waiting: deque[tuple[Sequence[FinalizedBlock], bytes]] = deque()

    @property
    def position(self) -> Position | None:
        return self._inner.position

    async def commit(self, blocks: Sequence[FinalizedBlock], finality: bytes) -> Position:
        """Store blocks; returns once they are durable. Raises STORAGE_FULL."""
        if self.is_full:
            raise BlockRobotError("STORAGE_FULL", "No space is left for the ledger.")
        self._on_handed(blocks)
        self._waiting.append((blocks, finality))
        self.before_commit()
        await asyncio.sleep(self._dice.uniform(0.2, self.sync_max_ms) / 1000)
        self._waiting.popleft()
        await self._inner.commit(blocks, finality)
        self._on_durable(blocks)
        return blocks[-1].position

    async def prune(self, below_height: int, reduce: Callable[[bytes], bytes]) -> int:
        return await self._inner.prune(below_height, reduce)

    def snapshot(self) -> MemorySnapshot:
        snapshot = SimSnapshot(self._inner._tables)
        if len(self._open) >= 64:
            self._open = [known for known in self._open if known._tables is not None]
        self._open.append(snapshot)
        return snapshot

    def found(self, first_block: FinalizedBlock) -> None:
        _finish(self._inner.commit([first_block], b""))

    def image(self) -> MemoryStore:
        backup = MemoryStore()
        backup._tables = self._inner._tables.copy()
        return backup

    def restore(self, image: MemoryStore) -> None:
        self._inner = image

    async def close(self) -> None:
        """Nothing is to be done: the store outlives its node."""

    def cut_power(self) -> None:
        while self._waiting and self._dice.random() < 0.3:
            blocks, finality = self._waiting.popleft()
            _finish(self._inner.commit(blocks, finality))
            self._on_durable(blocks)
        self._waiting.clear()
        for snapshot in self._open:
            snapshot.close()
        self._open.clear()


def _finish(commit: Coroutine[object, object, Position]) -> None:
    try:
        commit.send(None)
    except StopIteration:
        return
    raise AssertionError("the store in memory waited")


def _nothing() -> None:
    """Do nothing: no power cut is armed."""

"""A little chain of blocks for stores to keep, and both stores to keep it."""

from __future__ import annotations

import random

import pytest

from contracts.state.view import MemoryState
from node.storage.ledger_store import FinalizedBlock
from node.storage.lmdb_store import LmdbStore
from node.storage.memory_store import MemoryStore


class Chain:
    """Makes consecutive blocks that write state; `state` is what a store must hold after the newest."""

    def __init__(self) -> None:
        self.state = MemoryState()
        self.blocks: list[FinalizedBlock] = []
        self._random = random.Random(7)

    def block(self, writes=None, *, transactions: int = 2, events: int = 3, later_ms: int = 1000, size: int = 100):
        """Return the next block; a few keys come and go unless `writes` says otherwise."""
        height = len(self.blocks)
        if writes is None:
            writes = {b"records\x00%d" % self._random.randrange(500): self._random.randbytes(20) for _ in range(20)}
            writes |= {b"records\x00%d" % self._random.randrange(500): None for _ in range(5)}
        update = self.state.apply(writes)
        timestamp_ms = later_ms + (self.blocks[-1].timestamp_ms if self.blocks else 0)
        block = FinalizedBlock(
            height=height,
            block_id=self._random.randbytes(32),
            block_bytes=b"block %d " % height + self._random.randbytes(size),
            receipts_bytes=b"receipts %d" % height,
            timestamp_ms=timestamp_ms,
            state_root=update.root,
            transactions=[(self._random.randbytes(32), timestamp_ms + 5000) for _ in range(transactions)],
            state_writes=writes,
            page_writes=update.pages,
            events=[b"event %d of %d" % (index, height) for index in range(events)],
        )
        self.blocks.append(block)
        return block


@pytest.fixture
def chain():
    return Chain()


@pytest.fixture(params=["lmdb", "memory"])
async def store(request, tmp_path):
    opened = MemoryStore() if request.param == "memory" else LmdbStore.create(tmp_path / "ledger")
    yield opened
    await opened.close()


@pytest.fixture
async def lmdb_store(tmp_path):
    opened = LmdbStore.create(tmp_path / "ledger")
    yield opened
    await opened.close()

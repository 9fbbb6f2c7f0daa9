"""The process that gets killed: stores blocks and journals records without end, and says what is safe.

Run as `python storage_writer.py DIRECTORY`; says `stored HEIGHT` and `journalled SEQUENCE` after each promise.
"""

from __future__ import annotations

import asyncio
import hashlib
import sys
from pathlib import Path

from contracts.state.view import MemoryState, Overlay
from node.consensus.journal import Journal
from node.storage.ledger_store import FinalizedBlock
from node.storage.lmdb_store import LmdbStore


def digest(label: str, *numbers: int) -> bytes:
    return hashlib.sha256(":".join([label, *map(str, numbers)]).encode()).digest()


def writes_of(height: int) -> dict[bytes, bytes | None]:
    """Return what block `height` writes: always the same, with keys that come back, change and go."""
    writes: dict[bytes, bytes | None] = {}
    for index in range(40):
        seed = digest("write", height, index)
        key = b"records\x00%d" % (int.from_bytes(seed[:4], "big") % 2000)
        writes[key] = None if seed[4] < 64 else seed * (1 + seed[5] % 8)
    return writes


def block_of(height: int, state: MemoryState | Overlay, writes: dict[bytes, bytes | None]) -> FinalizedBlock:
    """Return the finalized block of a height whose state (after it) and writes are given."""
    return FinalizedBlock(
        height=height,
        block_id=digest("block", height),
        block_bytes=digest("bytes", height) * 100,
        receipts_bytes=digest("receipts", height),
        timestamp_ms=1000 * (height + 1),
        state_root=state.state_root,
        transactions=[(digest("tx", height, index), 1000 * height + 5000) for index in range(3)],
        state_writes=writes,
        page_writes=state.page_writes if isinstance(state, Overlay) else {},
        events=[digest("event", height)],
    )


def next_blocks(store: LmdbStore, count: int) -> list[FinalizedBlock]:
    """Execute the next blocks as a node does: on overlays over what the store holds."""
    blocks = []
    with store.snapshot() as view:
        height = 0 if view.position is None else view.position.height + 1
        parent = view
        for number in range(height, height + count):
            writes = writes_of(number)
            parent = Overlay.apply(parent, writes)
            blocks.append(block_of(number, parent, writes))
    return blocks


def say(promise: str, number: int) -> None:
    sys.stdout.write(f"{promise} {number}\n")
    sys.stdout.flush()


async def store_blocks(store: LmdbStore) -> None:
    turn = 0
    while True:
        turn += 1
        blocks = next_blocks(store, 1 + turn % 3)
        if turn % 2:
            position = await store.commit(blocks, digest("finality", blocks[-1].height))
        else:
            waiting = [store.commit([block], digest("finality", block.height)) for block in blocks]
            position = (await asyncio.gather(*waiting))[-1]
        say("stored", position.height)


async def keep_journal(journal: Journal) -> None:
    while True:
        sequence = 0
        for _ in range(3):
            sequence = journal.append(b"%d " % journal.next_sequence + digest("vote", journal.next_sequence) * 20)
        safe = await asyncio.to_thread(journal.sync)
        assert safe >= sequence
        say("journalled", safe)


async def work(store: LmdbStore, journal: Journal) -> None:
    await asyncio.gather(store_blocks(store), keep_journal(journal))


def main(directory: Path) -> None:
    ledger, votes = directory / "ledger", directory / "votes"
    store = LmdbStore.open(ledger) if ledger.exists() else LmdbStore.create(ledger)
    journal = Journal.open(votes) if votes.exists() else Journal.create(votes)
    asyncio.run(work(store, journal))


if __name__ == "__main__":
    main(Path(sys.argv[1]))

"""Any state comes back from its snapshot with the same root, and no flipped bit is overlooked."""

from __future__ import annotations

import asyncio

import pytest
from hypothesis import given
from hypothesis import strategies as st

from consensus.errors import BlockRobotError
from node.snapshot.checking import restore_into
from node.snapshot.making import make_snapshot
from node.snapshot.snapshot_format import MANIFEST_NAME, MemorySnapshotFolder, chunk_name
from node.storage.memory_store import MemoryRestore, MemoryStore
from tests.unit.node.written_chain import WrittenChain

STATES = st.dictionaries(st.binary(min_size=1, max_size=60), st.binary(max_size=200), max_size=40)


def snapshot_of(state: dict[bytes, bytes], blocks: int) -> tuple[WrittenChain, MemorySnapshotFolder]:
    chain = WrittenChain()
    chain.extend(state)
    for _ in range(blocks):
        chain.extend({})
    store, folder = MemoryStore(), MemorySnapshotFolder()
    asyncio.run(chain.fill(store))
    with store.snapshot() as ledger:
        make_snapshot(ledger, folder)
    return chain, folder


@given(state=STATES, blocks=st.integers(0, 2))
def test_any_state_comes_back_with_its_root(state: dict[bytes, bytes], blocks: int) -> None:
    chain, folder = snapshot_of(state, blocks)
    restore = MemoryRestore()
    restore_into(folder, chain.genesis, restore)
    assert restore.store is not None
    with restore.store.snapshot() as view:
        assert dict(view.scan(b"", 10_000)) == state
        assert view.state_root == chain.state.state_root


CHAIN, FOLDER = snapshot_of({b"records\x00%d" % number: b"value" * number for number in range(20)}, 2)
PARTS = {MANIFEST_NAME: FOLDER.manifest(), **{chunk_name(index): data for index, data in FOLDER.chunks.items()}}
BITS = [(name, bit) for name, data in PARTS.items() for bit in range(8 * len(data))]


@given(place=st.integers(0, len(BITS) - 1))
def test_a_flipped_bit_anywhere_is_refused(place: int) -> None:
    name, bit = BITS[place]
    damaged = bytearray(PARTS[name])
    damaged[bit // 8] ^= 1 << bit % 8
    other = MemorySnapshotFolder()
    other.manifest_bytes, other.chunks = FOLDER.manifest(), dict(FOLDER.chunks)
    if name == MANIFEST_NAME:
        other.manifest_bytes = bytes(damaged)
    else:
        other.chunks[next(index for index in FOLDER.chunks if chunk_name(index) == name)] = bytes(damaged)
    restore = MemoryRestore()
    with pytest.raises(BlockRobotError) as refused:
        restore_into(other, CHAIN.genesis, restore)
    assert refused.value.code in {"SNAPSHOT_DAMAGED", "SNAPSHOT_VERSION"}
    assert restore.store is None

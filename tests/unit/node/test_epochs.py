"""Where an epoch begins is read from the ledger, which must not tell of another epoch than the one asked for."""

from __future__ import annotations

import pytest

from consensus.errors import BlockRobotError
from consensus.settings import ChainSettings, Epoch
from node.epochs import read_start
from node.storage.memory_store import MemoryStore
from tests.unit.node.hand_made_chain import KEYS
from tests.unit.node.written_chain import WrittenChain


async def test_a_proof_of_another_epoch_in_the_place_of_the_one_asked_for_is_damage() -> None:
    chain = WrittenChain()
    producers = tuple(key.public_key for key in KEYS)
    for number in (1, 2):
        chain.extend()
        chain.extend(next_epoch=Epoch(number, producers, (), ChainSettings()))
    store = MemoryStore()
    await chain.fill(store)
    with store.snapshot() as snapshot:
        assert [read_start(snapshot, chain.genesis, number).number for number in (0, 1, 2)] == [0, 1, 2]
    store._tables.epoch_proofs.reverse()
    with store.snapshot() as snapshot, pytest.raises(BlockRobotError) as refused:
        read_start(snapshot, chain.genesis, 2)
    assert refused.value.code == "STORAGE_DAMAGED"

"""Where an epoch begins is read from the ledger, and no other's proof lets anybody in; who begins it helps the others."""

from __future__ import annotations

import pytest

from consensus.chain.epoch_settings import ChainSettings, Epoch
from consensus.errors import BlockRobotError
from node.consensus.epoch_change import (
    KEPT_WORDS_OF_PEER_MAX_BYTES,
    KEPT_WORDS_OF_PEER_MAX_COUNT,
    Handover,
    read_start,
    start_of_genesis,
)
from node.p2p.wire import FrameKind
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


def _handover() -> Handover:
    start = start_of_genesis(WrittenChain().genesis)
    return Handover(start=start, ledger=MemoryStore(), send=lambda *_: True)


async def test_a_peer_comes_into_an_epoch_once_after_it_began_here_or_the_peer_was_in_an_earlier_one() -> None:
    """R25."""
    handover = _handover()
    assert [handover.note_word("b"), handover.note_word("c")] == [False, False]
    handover.answer("b", 0)
    handover.answer("b", 0)
    assert [handover.note_word("b"), handover.note_word("b"), handover.note_word("c")] == [True, False, False]
    handover.begin(handover.start, ["b", "c"])
    assert handover.silent == {"b", "c"}
    assert [handover.note_word("c"), handover.note_word("c")] == [True, False]
    assert handover.silent == {"b"}
    handover.stop()


async def test_a_peer_that_mixes_words_of_two_epochs_is_not_greeted_at_each_of_them() -> None:
    """R25: else two such producers greet each other for each word of a greeting, and drown the network."""
    handover = _handover()
    greeted = 0
    for _ in range(50):
        handover.answer("b", 0)
        greeted += handover.note_word("b")
    assert greeted == 1


async def test_words_for_the_next_epoch_of_one_peer_take_no_room_of_another_one() -> None:
    handover = _handover()
    handover.keep("b", FrameKind.PROPOSAL, b"a proposal")
    for number in range(2 * KEPT_WORDS_OF_PEER_MAX_COUNT):
        handover.keep("liar", FrameKind.VOTE, number.to_bytes(2))
    handover.keep("huge", FrameKind.PROPOSAL, bytes(KEPT_WORDS_OF_PEER_MAX_BYTES))
    handover.keep("huge", FrameKind.PROPOSAL, b"small")
    kept = handover.begin(handover.start, [])
    assert kept[0] == ("b", FrameKind.PROPOSAL, b"a proposal")
    newest = [payload for peer, _, payload in kept if peer == "liar"]
    assert newest == [
        number.to_bytes(2) for number in range(KEPT_WORDS_OF_PEER_MAX_COUNT, 2 * KEPT_WORDS_OF_PEER_MAX_COUNT)
    ]
    assert [payload for peer, _, payload in kept if peer == "huge"] == [b"small"]
    assert handover.begin(handover.start, []) == []
    handover.stop()

"""Where an epoch begins is read from the ledger, and no other's proof lets anybody in; who begins it helps the others."""

from __future__ import annotations

import pytest

from consensus.chain.epoch_settings import ChainSettings, Epoch
from consensus.errors import BlockRobotError
from node.consensus.epoch_change import (
    BUFFERED_MESSAGES_PER_PEER_MAX_BYTES,
    BUFFERED_MESSAGES_PER_PEER_MAX_COUNT,
    EpochTransition,
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


def _epoch_transition() -> EpochTransition:
    start = start_of_genesis(WrittenChain().genesis)
    return EpochTransition(start=start, ledger=MemoryStore(), send=lambda *_: True)


async def test_a_peer_comes_into_an_epoch_once_after_it_began_here_or_the_peer_was_in_an_earlier_one() -> None:
    """R25."""
    transition = _epoch_transition()
    assert [transition.record_message_from("b"), transition.record_message_from("c")] == [False, False]
    transition.answer("b", 0)
    transition.answer("b", 0)
    assert [
        transition.record_message_from("b"),
        transition.record_message_from("b"),
        transition.record_message_from("c"),
    ] == [True, False, False]
    transition.begin(transition.start, ["b", "c"])
    assert transition.silent == {"b", "c"}
    assert [transition.record_message_from("c"), transition.record_message_from("c")] == [True, False]
    assert transition.silent == {"b"}
    transition.stop()


async def test_a_peer_that_mixes_words_of_two_epochs_is_not_greeted_at_each_of_them() -> None:
    """R25: else two such producers greet each other for each word of a greeting, and drown the network."""
    transition = _epoch_transition()
    greeted = 0
    for _ in range(50):
        transition.answer("b", 0)
        greeted += transition.record_message_from("b")
    assert greeted == 1


async def test_words_for_the_next_epoch_of_one_peer_take_no_room_of_another_one() -> None:
    transition = _epoch_transition()
    transition.keep("b", FrameKind.PROPOSAL, b"a proposal")
    for number in range(2 * BUFFERED_MESSAGES_PER_PEER_MAX_COUNT):
        transition.keep("liar", FrameKind.VOTE, number.to_bytes(2))
    transition.keep("huge", FrameKind.PROPOSAL, bytes(BUFFERED_MESSAGES_PER_PEER_MAX_BYTES))
    transition.keep("huge", FrameKind.PROPOSAL, b"small")
    kept = transition.begin(transition.start, [])
    assert kept[0] == ("b", FrameKind.PROPOSAL, b"a proposal")
    newest = [payload for peer, _, payload in kept if peer == "liar"]
    assert newest == [
        number.to_bytes(2)
        for number in range(BUFFERED_MESSAGES_PER_PEER_MAX_COUNT, 2 * BUFFERED_MESSAGES_PER_PEER_MAX_COUNT)
    ]
    assert [payload for peer, _, payload in kept if peer == "huge"] == [b"small"]
    assert transition.begin(transition.start, []) == []
    transition.stop()

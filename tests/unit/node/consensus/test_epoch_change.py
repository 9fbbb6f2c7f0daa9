"""A schedule change on running nodes: each goes over by itself, late ones are helped, and a restart finds its epoch."""

from __future__ import annotations

import asyncio
import itertools

from consensus.chain.block import EpochProof
from consensus.chain.journal_records import JournalRecord
from consensus.primitives.encoding import decode, encode
from contracts.execution.epochs import read_epoch
from node.p2p.wire import FrameKind, HeightNotice
from node.storage.memory_store import MemoryStore
from tests.unit.node.small_nodes import SmallNodes, make_genesis, producer_key
from tests.virtual_time import in_virtual_time, virtual_now_ms

NAMES = ["a", "b", "c", "d"]


async def _change(crowd: SmallNodes, node: str = "a", base_timeout_ms: int = 400) -> None:
    await crowd.finalize(node, crowd.transaction("settings", "propose", "base_timeout_ms", base_timeout_ms))


async def _go_on(crowd: SmallNodes, *nodes: str) -> None:
    for node in nodes or tuple(crowd.nodes):
        await crowd.finalize(node, crowd.transaction("identity", "authenticate", bytes(32)))


@in_virtual_time
async def test_a_change_of_settings_begins_an_epoch_on_all_nodes_and_the_chain_goes_on() -> None:
    crowd = await SmallNodes(make_genesis(NAMES)).start()
    await _change(crowd)
    changed_ms = virtual_now_ms()
    await crowd.wait_epoch(1)
    assert virtual_now_ms() - changed_ms < 1_000
    for node in crowd.nodes.values():
        assert node.engine.epoch.epoch.settings.base_timeout_ms == 400
    await _go_on(crowd, "b", "c")
    assert virtual_now_ms() - changed_ms < 2_000
    assert len(crowd.newest_common()) == 1
    assert not any(node.peers._epoch_transition.silent for node in crowd.nodes.values())
    with crowd.ledgers["d"].snapshot() as snapshot:
        data = snapshot.epoch_proof(1)
        assert data is not None
        assert decode(data, EpochProof).epoch == read_epoch(snapshot)
    await crowd.stop()


@in_virtual_time
async def test_nodes_that_do_not_produce_follow_into_the_epoch_without_load() -> None:
    crowd = await SmallNodes(make_genesis(NAMES, followers=["e"])).start()
    await _change(crowd)
    await crowd.wait_epoch(1, timeout_s=5)
    assert crowd.nodes["e"].core.index is None
    await _go_on(crowd, "e")
    await crowd.stop()


@in_virtual_time
async def test_a_producer_that_missed_two_epochs_is_brought_into_the_third() -> None:
    crowd = await SmallNodes(make_genesis(NAMES)).start()
    crowd.cut_off = {"d"}
    for base_timeout_ms in (400, 300):
        await _change(crowd, base_timeout_ms=base_timeout_ms)
        await _go_on(crowd, "b")
    assert crowd.nodes["d"].core.epoch == 0
    assert crowd.nodes["a"].peers._epoch_transition.silent == {"d"}
    crowd.heal()
    await crowd.wait_epoch(2, timeout_s=10)
    await _go_on(crowd, "d", "c")
    assert len(crowd.newest_common()) == 1
    assert crowd.nodes["a"].peers._epoch_transition.silent == set()
    await crowd.stop()


@in_virtual_time
async def test_whoever_stops_after_the_boundary_wakes_up_in_the_new_epoch() -> None:
    crowd = await SmallNodes(make_genesis(NAMES)).start()
    await _go_on(crowd, "a")
    await _change(crowd)
    await crowd.wait_epoch(1)
    heights = {node.feed.height for node in crowd.nodes.values()}
    await crowd.stop()
    with crowd.ledgers["a"].snapshot() as snapshot:
        assert snapshot.position is not None
        assert {snapshot.position.height} == heights
        assert snapshot.epoch_proof(1) is not None
    await crowd.start()
    assert {node.core.epoch for node in crowd.nodes.values()} == {1}
    await _go_on(crowd)
    assert len(crowd.newest_common()) == 1
    await crowd.stop()


@in_virtual_time
async def test_a_stop_between_the_stored_boundary_and_the_new_journal_does_no_harm() -> None:
    crowd = await SmallNodes(make_genesis(NAMES)).start()
    await _go_on(crowd, "a")
    kept = {name: list(journal.records) for name, journal in crowd.journals.items()}
    await _change(crowd)
    await crowd.wait_epoch(1)
    await crowd.stop()
    for name, journal in crowd.journals.items():
        assert all(decode(record, JournalRecord).epoch == 1 for _, record in journal.records)
        journal.records = kept[name]
    await crowd.start()
    assert {node.core.epoch for node in crowd.nodes.values()} == {1}
    assert {node.core.last_voted_round for node in crowd.nodes.values()} == {0}
    await _go_on(crowd, "c")
    await crowd.stop()


@in_virtual_time
async def test_a_removed_producer_follows_and_its_votes_count_no_more() -> None:
    crowd = await SmallNodes(make_genesis([*NAMES, "e"])).start()
    await crowd.finalize("a", crowd.transaction("producers", "remove", producer_key("d").public_key))
    await crowd.wait_epoch(1)
    assert crowd.nodes["d"].core.index is None
    assert len(crowd.nodes["a"].engine.epoch.schedule.producers) == 4
    await _go_on(crowd, "d")
    # With one of the other four away, a quorum of three is needed: d's voice would not make up for a second one.
    crowd.cut_off = {"a", "b"}
    transaction = crowd.transaction("identity", "authenticate", bytes(32))
    await crowd.nodes["d"].pool.submit([transaction.wire])
    assert not await crowd.nodes["d"].pool.wait_final(transaction.txid, 20_000)
    crowd.heal()
    assert await crowd.nodes["d"].pool.wait_final(transaction.txid, 60_000)
    await crowd.stop()


@in_virtual_time
async def test_the_chain_goes_on_under_load_with_a_short_gap_at_the_boundary() -> None:
    crowd = await SmallNodes(make_genesis(NAMES)).start()
    times: list[int] = []
    for node in crowd.nodes.values():
        node.writer.add_listener(lambda *_: times.append(virtual_now_ms()))

    async def load(node: str) -> None:
        for _ in range(60):
            await crowd.finalize(node, crowd.transaction("identity", "authenticate", bytes(32)))

    loads = [asyncio.create_task(load(node)) for node in NAMES]
    for base_timeout_ms in (450, 400, 350):
        await _change(crowd, "b", base_timeout_ms)
    await asyncio.gather(*loads)
    await crowd.wait_epoch(3)
    times.sort()
    assert max(later - earlier for earlier, later in itertools.pairwise(times)) < 1_000
    assert len(crowd.newest_common()) == 1
    await crowd.stop()


@in_virtual_time
async def test_whoever_is_first_heard_in_an_epoch_is_greeted_with_the_last_words() -> None:
    """R25: a proposal that came before its addressee had begun the epoch is lost; so it is said again."""
    crowd = await SmallNodes(make_genesis(NAMES)).start()
    await _change(crowd)
    await crowd.wait_epoch(1)
    await asyncio.sleep(1)
    node, links = crowd.nodes["a"], crowd.links["a"]
    links.handler.peer_frame("d", FrameKind.HEIGHT, encode(HeightNotice(finalized_height=0, epoch=0)))
    words = [encode(word) for word in node.core._latest_messages()]
    links.sent.clear()
    for _ in range(2):
        height = HeightNotice(finalized_height=node.feed.height, epoch=1)
        links.handler.peer_frame("d", FrameKind.HEIGHT, encode(height))
    greeting = [payload for peer, _, payload in links.sent if peer == "d"]
    assert words
    assert greeting == words
    await crowd.stop()


@in_virtual_time
async def test_a_ledger_that_was_lost_comes_back_and_the_journal_has_forgotten_nothing() -> None:
    """R37: the store begins at genesis again, the journal speaks of epoch 1: kept until epoch 1 is reached again."""
    crowd = await SmallNodes(make_genesis(NAMES)).start()
    await _change(crowd)
    await crowd.wait_epoch(1)
    await _go_on(crowd, *NAMES)
    said_round = crowd.nodes["d"].core.last_voted_round
    assert said_round > 0
    await crowd.stop()
    journal = crowd.journals["d"]
    crowd.ledgers["d"] = MemoryStore()
    await crowd.start("d")
    await asyncio.sleep(1)
    lost = crowd.nodes["d"]
    assert lost.core.epoch == 0
    assert lost.core.lockout is not None
    assert "epoch 1" in lost.core.lockout.until
    lost.engine._journal_writer.rewrite()
    assert max(decode(record, JournalRecord).epoch for _, record in journal.records) == 1
    await crowd.start("a", "b", "c")
    await crowd.wait_epoch(1, "d")
    assert lost.core.last_voted_round >= said_round
    await _go_on(crowd, "a", "d")
    assert len(crowd.newest_common()) == 1
    await crowd.stop()


@in_virtual_time
async def test_words_of_an_epoch_that_is_over_are_answered_with_the_proof_that_ended_it() -> None:
    crowd = await SmallNodes(make_genesis(NAMES)).start()
    old_notice = encode(crowd.nodes["d"].core._latest_messages()[0])
    await _change(crowd)
    await crowd.wait_epoch(1)
    await asyncio.sleep(1)
    links = crowd.links["a"]
    links.sent.clear()
    for _ in range(5):
        links.handler.peer_frame("d", FrameKind.NOTICE, old_notice)
    answers = [payload for peer, kind, payload in links.sent if kind is FrameKind.EPOCH]
    assert len(answers) == 1, "the answer is limited, whatever is asked"
    assert decode(answers[0], EpochProof).epoch.number == 1
    await crowd.stop()


@in_virtual_time
async def test_a_candidate_says_that_it_is_ready_and_enters_by_itself() -> None:
    crowd = await SmallNodes(make_genesis([*NAMES, "e"])).start()
    key = producer_key("e").public_key
    await crowd.finalize("a", crowd.transaction("producers", "remove", key))
    await crowd.wait_epoch(1)
    await crowd.stop("e")
    await crowd.finalize("a", crowd.transaction("producers", "propose", key))
    await asyncio.sleep(30)
    assert crowd.nodes["a"].core.epoch == 1, "a candidate that is away is not seated"
    await crowd.start("e")
    await crowd.wait_epoch(2, timeout_s=10)
    assert crowd.nodes["e"].core.index == 4
    await _go_on(crowd)
    assert len(crowd.newest_common()) == 1
    await crowd.stop()


@in_virtual_time
async def test_a_network_grows_from_four_to_ten_and_shrinks_again_under_load() -> None:
    names = [f"n{number}" for number in range(10)]
    crowd = await SmallNodes(make_genesis(names)).start()
    stop = asyncio.Event()

    async def load(node: str) -> None:
        while not stop.is_set():
            await crowd.finalize(node, crowd.transaction("identity", "authenticate", bytes(32)))
            await asyncio.sleep(0.05)

    async def decide(entry: str, chosen: list[str], seats: int) -> None:
        for name in chosen:
            await crowd.finalize("n1", crowd.transaction("producers", entry, producer_key(name).public_key))
        async with asyncio.timeout(60):
            while any(len(node.engine.epoch.epoch.producers) != seats for node in crowd.nodes.values()):  # noqa: ASYNC110
                await asyncio.sleep(0.01)

    loads = [asyncio.create_task(load(node)) for node in ("n0", "n5", "n9")]
    await decide("remove", names[4:], 4)
    await decide("propose", names[4:7], 7)
    await decide("propose", names[7:], 10)
    assert all(node.core.index is not None for node in crowd.nodes.values())
    await decide("remove", names[:3], 7)
    await decide("remove", names[3:6], 4)
    stop.set()
    await asyncio.gather(*loads)
    assert [node.core.index for node in crowd.nodes.values()][:6] == [None] * 6
    assert len(crowd.newest_common()) == 1
    await crowd.stop()

"""A node far behind, and its peers: honest ones, liars, one that stalls, one that boasts, one that pruned."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest

from consensus.chain.block import Block
from consensus.chain.epoch_settings import ChainSettings, Epoch
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode, encode
from node.consensus.epoch_change import EpochStart, start_of_genesis
from node.execution.block_executor import Executor
from node.ledger.ledger_writer import FinalityFeed, LedgerWriter
from node.mempool.transaction_cache import TransactionCache
from node.p2p.wire import BlockBatch, FinalizedRequest, RequestKind
from node.snapshot.making import header_of_block
from node.storage.memory_store import MemoryStore
from node.sync import block_sync
from node.sync.block_ranges import read_range
from node.sync.block_sync import RANGE_COUNT, Synchroniser
from tests.unit.node.hand_made_chain import KEYS
from tests.unit.node.written_chain import WritingMachine, WrittenChain
from tests.virtual_time import in_virtual_time

Serve = Callable[[FinalizedRequest], Awaitable[BlockBatch]]


@pytest.fixture(autouse=True)
def inline(monkeypatch: pytest.MonkeyPatch) -> None:
    """No threads: virtual time would run ahead of them."""
    monkeypatch.setattr(block_sync, "INLINE_WEIGHT_MAX", 1_000_000)


class Behind:
    """A node that holds genesis only, and peers that are told how to answer."""

    def __init__(self, chain: WrittenChain) -> None:
        self.chain = chain
        self.ledger = MemoryStore()
        self.full = MemoryStore()
        self.asked: list[tuple[str, int]] = []
        self.peers: dict[str, Serve] = {}

    async def start(self) -> None:
        chain = self.chain
        await self.ledger.commit(chain.stored[:1], b"")
        await chain.fill(self.full)
        self.engine = SimpleNamespace(epoch=start_of_genesis(chain.genesis))
        self.executor = Executor(
            genesis=chain.genesis, ledger=self.ledger, machine=WritingMachine(), cache=TransactionCache(), key=None
        )
        self.feed = FinalityFeed(0)
        self.writer = LedgerWriter(self.ledger)
        self.writer.add_listener(self._note_epoch)
        self.writer.add_listener(self.feed.publish)
        self.writer.start(
            on_failure=lambda _reason: None, on_recovery=lambda: None, between_events=lambda action: action()
        )
        nothing: Any = self.engine
        self.sync = Synchroniser(
            genesis=chain.genesis,
            ledger=self.ledger,
            engine=nothing,
            executor=self.executor,
            writer=self.writer,
            feed=self.feed,
            requester=self,
        )

    def _note_epoch(self, blocks: Any, *_: Any) -> None:
        self.executor.move_base()
        head = blocks[-1]
        if head.next_epoch is not None:
            self.engine.epoch = EpochStart(head.next_epoch, head.block_id)

    async def honest(self, request: FinalizedRequest) -> BlockBatch:
        await asyncio.sleep(0.002)
        with self.full.snapshot() as snapshot:
            return read_range(snapshot, request.from_height, request.count)

    async def request(self, peer: str, kind: RequestKind, body: bytes) -> bytes:
        assert kind is RequestKind.FINALIZED
        request = decode(body, FinalizedRequest)
        self.asked.append((peer, request.from_height))
        return encode(await self.peers[peer](request))

    async def catch_up(self, heights: dict[str, int], **peers: Serve) -> None:
        self.peers = dict.fromkeys(heights, self.honest) | peers
        for peer, height in heights.items():
            self.sync.note_height(peer, height)
        if self.sync._task is not None:
            await self.sync._task

    async def stop(self) -> None:
        await self.sync.stop()
        await self.writer.stop()
        self.executor.close()

    def assert_equal_to(self, height: int) -> None:
        with self.ledger.snapshot() as own, self.full.snapshot() as theirs:
            assert own.position is not None
            assert own.position.height == height
            assert list(own.iter_blocks(0, height + 1)) == list(theirs.iter_blocks(0, height + 1))
            assert all(own.receipts(number) == theirs.receipts(number) for number in range(1, height + 1))
            if own.position == theirs.position:
                assert list(own.scan(b"", 10_000)) == list(theirs.scan(b"", 10_000))


@in_virtual_time
async def story(blocks: int, tell: Callable[[Behind], Awaitable[None]], chain: WrittenChain | None = None) -> None:
    behind = Behind(chain or long_chain(blocks))
    await behind.start()
    try:
        await tell(behind)
    finally:
        await behind.stop()


def long_chain(blocks: int) -> WrittenChain:
    chain = WrittenChain()
    for _ in range(blocks):
        chain.extend(transactions=2)
    return chain


def test_a_long_gap_is_closed_from_several_peers_at_once() -> None:
    async def tell(behind: Behind) -> None:
        await behind.catch_up({"b": 400, "c": 400, "d": 400})
        behind.assert_equal_to(400)
        assert {peer for peer, _ in behind.asked} == {"b", "c", "d"}
        assert len(behind.asked) <= 400 // RANGE_COUNT + 2
        assert behind.sync.blocks_installed_count == 400

    story(400, tell)


@pytest.mark.parametrize("missed", [1, 5])
def test_a_short_gap_is_closed_once_it_has_stayed_for_a_while(missed: int) -> None:
    """On an idle network a node that missed the last blocks hears of no further one."""

    async def tell(behind: Behind) -> None:
        await behind.catch_up({"b": missed})
        for _ in range(3):
            behind.assert_equal_to(0)
            behind.sync.recheck()
            await asyncio.sleep(1)
        behind.assert_equal_to(missed)
        behind.sync.recheck()
        assert not behind.sync.is_running

    story(missed, tell)


def test_who_says_to_keep_a_block_is_known_without_asking_for_it() -> None:
    async def tell(behind: Behind) -> None:
        behind.peers = dict.fromkeys(("whole", "short", "silent"), behind.honest)
        behind.sync.note_height("whole", 120, 0)
        behind.sync.note_height("short", 120, 90)
        behind.sync.note_height("silent", 120)
        assert behind.sync.peers_with_block(7) == ["whole"]
        assert behind.sync.peers_with_block(90) == ["short", "whole"]
        assert behind.sync.peers_with_block(121) == []
        behind.sync.forget("whole")
        assert behind.sync.peers_with_block(7) == []

    story(120, tell)


def test_a_peer_that_boasts_of_a_block_is_not_asked_for_it_again_and_again() -> None:
    async def tell(behind: Behind) -> None:
        await behind.catch_up({"boaster": 6})
        for _ in range(60):
            behind.sync.recheck()
            await asyncio.sleep(1)
        behind.assert_equal_to(5)
        assert len(behind.asked) < 4

    story(5, tell)


def test_a_proved_gap_ends_with_its_last_block_whatever_a_peer_goes_on_to_claim() -> None:
    """While a proved gap is being closed a node is not ready and leaves the newest blocks to sync: no claim keeps it so."""

    async def tell(behind: Behind) -> None:
        async def slow(request: FinalizedRequest) -> BlockBatch:
            await asyncio.sleep(0.1)
            return await behind.honest(request)

        behind.peers = {"b": slow, "c": slow}
        closing = []
        for _ in range(100):
            for peer in behind.peers:
                behind.sync.note_height(peer, 1_000)
            assert behind.sync.is_running
            closing.append(behind.sync.closes_gap)
            await asyncio.sleep(0.02)
        behind.assert_equal_to(40)
        assert any(closing)
        assert not any(closing[-50:])

    story(40, tell)


def test_a_peer_that_changes_a_transaction_is_found_out_and_asked_no_more() -> None:
    async def tell(behind: Behind) -> None:
        async def lie(request: FinalizedRequest) -> BlockBatch:
            batch = await behind.honest(request)
            block = decode(batch.blocks[2], Block)
            forged = encode(msgspec.structs.replace(block, transactions=block.transactions[:1]))
            return msgspec.structs.replace(batch, blocks=(*batch.blocks[:2], forged, *batch.blocks[3:]))

        await behind.catch_up({"liar": 300, "c": 300}, liar=lie)
        behind.assert_equal_to(300)
        assert 1 <= sum(peer == "liar" for peer, _ in behind.asked) <= 6
        asked = len(behind.asked)
        behind.sync.note_height("liar", 10_000)
        await asyncio.sleep(1)
        assert len(behind.asked) == asked

    story(300, tell)


def test_a_peer_that_breaks_a_signature_inside_of_a_transaction_is_found_out() -> None:
    """Neither the txid nor the block's id covers it."""

    async def tell(behind: Behind) -> None:
        async def lie(request: FinalizedRequest) -> BlockBatch:
            batch = await behind.honest(request)
            block = decode(batch.blocks[0], Block)
            wire = block.transactions[0][:-1] + bytes([block.transactions[0][-1] ^ 1])
            forged = encode(msgspec.structs.replace(block, transactions=(wire, *block.transactions[1:])))
            return msgspec.structs.replace(batch, blocks=(forged, *batch.blocks[1:]))

        await behind.catch_up({"liar": 100, "c": 100}, liar=lie)
        behind.assert_equal_to(100)

    story(100, tell)


def test_a_peer_that_stalls_holds_nobody_up_for_long() -> None:
    async def tell(behind: Behind) -> None:
        async def stall(_request: FinalizedRequest) -> BlockBatch:
            await asyncio.sleep(3600)
            raise AssertionError

        await behind.catch_up({"mule": 300, "c": 300}, mule=stall)
        behind.assert_equal_to(300)

    story(300, tell)


def test_a_peer_that_boasts_of_a_height_is_believed_as_far_as_it_shows() -> None:
    async def tell(behind: Behind) -> None:
        await behind.catch_up({"boaster": 1_000_000})
        behind.assert_equal_to(120)
        assert len(behind.asked) < 40

    story(120, tell)


def test_a_peer_that_pruned_is_passed_over_for_one_that_has_the_blocks() -> None:
    async def tell(behind: Behind) -> None:
        pruned = MemoryStore()
        await behind.chain.fill(pruned)
        await pruned.prune(150, header_of_block)

        async def short(request: FinalizedRequest) -> BlockBatch:
            with pruned.snapshot() as snapshot:
                return read_range(snapshot, request.from_height, request.count)

        await behind.catch_up({"pruned": 200, "full": 200}, pruned=short)
        behind.assert_equal_to(200)
        alone = Behind(behind.chain)
        await alone.start()
        await alone.catch_up({"pruned": 200}, pruned=short)
        assert alone.ledger.position == behind.chain.stored[0].position
        assert alone.sync.snapshot_peers(0) == (["pruned"], 0)
        assert behind.sync.snapshot_peers(0)[0] == []
        await alone.stop()

    story(200, tell)


def test_a_peer_that_fails_in_the_middle_is_replaced() -> None:
    async def tell(behind: Behind) -> None:
        async def fail(request: FinalizedRequest) -> BlockBatch:
            if request.from_height > 100:
                raise BlockRobotError("PEER_UNAVAILABLE")
            return await behind.honest(request)

        await behind.catch_up({"b": 300, "c": 300}, b=fail)
        behind.assert_equal_to(300)

    story(300, tell)


def test_epochs_are_followed_on_the_way() -> None:
    chain = long_chain(90)
    for number in range(1, 4):
        chain.extend({}, next_epoch=Epoch(number, tuple(key.public_key for key in KEYS), (), ChainSettings()))
        for _ in range(70):
            chain.extend(transactions=1)

    async def tell(behind: Behind) -> None:
        height = len(chain.blocks) - 1
        await behind.catch_up({"b": height, "c": height})
        behind.assert_equal_to(height)
        assert behind.engine.epoch.number == 3

    story(0, tell, chain)


def test_blocks_that_the_node_finalizes_itself_meanwhile_are_not_stored_twice() -> None:
    async def tell(behind: Behind) -> None:
        async def slow(request: FinalizedRequest) -> BlockBatch:
            batch = await behind.honest(request)
            if request.from_height == 1:
                first = await behind.sync._check("own", [decode(batch.blocks[0], Block)], proof, 1)
                overtaken = behind.executor.verify(first.blocks[0].block)
                behind.writer.store([overtaken], first.proof)
            return batch

        short = WrittenChain()
        short.extend(transactions=2)
        proof = short.proof()
        await behind.catch_up({"b": 200}, b=slow)
        behind.assert_equal_to(200)

    story(200, tell)


def test_a_peer_that_boasts_and_gives_one_block_just_in_time_does_not_set_the_pace() -> None:
    async def tell(behind: Behind) -> None:
        loop, late_s = asyncio.get_running_loop(), block_sync.PATIENCE_MS / 1000 - 0.1

        async def drip(request: FinalizedRequest) -> BlockBatch:
            await asyncio.sleep(late_s)
            with behind.full.snapshot() as snapshot:
                return read_range(snapshot, request.from_height, 1)

        begun_s = loop.time()
        await behind.catch_up({"b": 400, "c": 400, "liar": 400 + RANGE_COUNT}, liar=drip)
        behind.assert_equal_to(400)
        assert loop.time() - begun_s < 5 * late_s
        assert sum(peer == "liar" for peer, _ in behind.asked) <= block_sync.RANGES_AHEAD_COUNT

    story(400, tell)

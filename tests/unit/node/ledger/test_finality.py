"""Who waits is told after the store holds the block, never before, and in order."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

from consensus.chain.block import FinalityProof, QuorumCertificate
from consensus.errors import BlockRobotError
from node.ledger.ledger_writer import FinalityFeed, LedgerWriter
from node.storage.ledger_store import Position

TXID = bytes(32)
PROOF = FinalityProof(
    header_bytes=b"", child_header_bytes=b"", child_qc=QuorumCertificate(epoch=0, round=1, block_id=b"", votes=())
)


def _block(height: int, *txids: bytes, next_epoch: Any = None) -> Any:
    return SimpleNamespace(
        header=SimpleNamespace(height=height),
        txids=frozenset(txids),
        next_epoch=next_epoch,
        to_stored=lambda _proof: SimpleNamespace(height=height),
    )


def _position(height: int) -> Position:
    return Position(height=height, block_id=bytes(32), state_root=bytes(32), timestamp_ms=height)


class Snapshot(str):
    """Stands for the ledger at one position."""

    __slots__ = ("closed",)

    def close(self) -> None:
        self.closed = True


class SlowLedger:
    """A store whose commits end when the test says so."""

    def __init__(self) -> None:
        self.position = _position(0)
        self.commits: list[list[int]] = []
        self.may_commit = asyncio.Event()
        self.refuses = False

    async def commit(self, blocks: list[Any], finality: bytes) -> Position:
        self.commits.append([block.height for block in blocks])
        await self.may_commit.wait()
        if self.refuses:
            raise BlockRobotError("STORAGE_UNWRITABLE")
        return _position(blocks[-1].height)

    def snapshot(self) -> Snapshot:
        return Snapshot("snapshot")


def _start(ledger: SlowLedger) -> tuple[LedgerWriter, list[tuple[list[int], int]], list[str]]:
    writer = LedgerWriter(ledger)  # type: ignore[arg-type]
    told: list[tuple[list[int], int]] = []
    failures: list[str] = []
    writer.add_listener(
        lambda blocks, _, position: told.append(([block.header.height for block in blocks], position.height))
    )
    writer.start(
        on_failure=failures.append,
        on_recovery=lambda: failures.append("recovered"),
        between_events=lambda action: action(),
    )
    return writer, told, failures


async def _let_run() -> None:
    for _ in range(5):
        await asyncio.sleep(0)


async def test_blocks_are_told_once_stored_together_and_none_twice() -> None:
    ledger = SlowLedger()
    writer, told, _ = _start(ledger)
    writer.store([_block(1)], PROOF)
    await _let_run()
    assert (ledger.commits, told) == ([[1]], [])
    ledger.may_commit.set()
    await writer.stop()
    assert told == [([1], 1)]
    ledger = SlowLedger()
    writer, told, _ = _start(ledger)
    writer.store([_block(1)], PROOF)
    await _let_run()
    writer.store([_block(2)], PROOF)
    writer.store([_block(2), _block(3)], PROOF)
    ledger.may_commit.set()
    await writer.stop()
    assert ledger.commits == [[1], [2, 3]]
    assert told == [([1], 1), ([2, 3], 3)]


async def test_a_boundary_is_the_last_block_of_its_commit_whatever_waits_behind_it() -> None:
    ledger = SlowLedger()
    writer, told, _ = _start(ledger)
    writer.store([_block(1)], PROOF)
    await _let_run()
    writer.store([_block(2), _block(3, next_epoch="the next")], PROOF)
    writer.store([_block(4)], PROOF)
    ledger.may_commit.set()
    await writer.stop()
    assert ledger.commits == [[1], [2, 3], [4]]
    assert told == [([1], 1), ([2, 3], 3), ([4], 4)]


async def test_a_store_that_takes_no_more_and_a_writer_that_fails_stop_the_node_from_signing() -> None:
    ledger = SlowLedger()
    ledger.refuses = True
    writer, told, failures = _start(ledger)
    writer.store([_block(1)], PROOF)
    ledger.may_commit.set()
    await writer.stop()
    assert told == []
    assert len(failures) == 1
    ledger = SlowLedger()
    writer, told, failures = _start(ledger)

    def fail(_snapshot: object) -> None:
        raise RuntimeError("no more threads")

    writer.set_milestones(1, fail)
    ledger.may_commit.set()
    writer.store([_block(1)], PROOF)
    await _let_run()
    assert len(failures) == 1
    assert "RuntimeError" in failures[0]
    async with asyncio.timeout(1):
        await writer.stop()
    assert told == []


async def test_blocks_are_stored_and_told_though_nothing_can_be_made_of_a_milestone() -> None:
    ledger = SlowLedger()
    writer, told, failures = _start(ledger)
    passed: list[object] = []

    def refuse(snapshot: object) -> None:
        passed.append(snapshot)
        raise BlockRobotError("FILE_UNUSABLE")

    writer.set_milestones(1, refuse)
    ledger.may_commit.set()
    for height in (1, 2):
        writer.store([_block(height)], PROOF)
        await _let_run()
    await writer.stop()
    assert passed == ["snapshot", "snapshot"]
    assert (told, failures) == ([([1], 1), ([2], 2)], [])


async def test_a_listener_that_fails_stops_the_node_from_signing_for_good() -> None:
    """Some have heard of the blocks and some have not: a store that takes writes again does not make that good."""
    ledger = SlowLedger()
    writer, told, failures = _start(ledger)

    def fail(*_: object) -> None:
        raise AssertionError("not to be")

    writer.add_listener(fail)
    ledger.may_commit.set()
    for height in (1, 2):
        writer.store([_block(height)], PROOF)
        await _let_run()
    assert ["AssertionError" in reason for reason in failures] == [True]
    assert told == [([1], 1), ([2], 2)]
    writer._failed = True
    writer.store([_block(3)], PROOF)
    await _let_run()
    assert "recovered" not in failures
    await writer.stop()


async def test_a_waiter_for_a_transaction_hears_of_it_and_one_that_expired_hears_so() -> None:
    feed, other = FinalityFeed(0), bytes([1]) * 32
    final = asyncio.ensure_future(feed.wait_final(TXID, 10_000))
    expired = asyncio.ensure_future(feed.wait_final(other, 10_000))
    await _let_run()
    feed.publish([_block(1, TXID)], PROOF, _position(1))
    feed.give_up([other])
    assert await final is True
    assert await expired is False


async def test_a_waiter_whose_time_is_over_leaves_nothing_behind() -> None:
    feed = FinalityFeed(3)
    assert await feed.wait_final(TXID, 1) is False
    assert await feed.wait_above(3, 1) is False
    assert await feed.wait_above(2, 1) is True
    assert not feed._transactions
    assert not feed._heights


async def test_one_listener_may_take_the_ledger_as_it_was_stored_and_else_it_is_closed() -> None:
    ledger = SlowLedger()
    ledger.may_commit.set()
    opened: list[Snapshot] = []
    ledger.snapshot = lambda: opened.append(Snapshot("s")) or opened[-1]  # type: ignore[func-returns-value,method-assign]
    writer, told, _ = _start(ledger)
    taken: list[object] = []
    writer.add_listener(
        lambda blocks, _, __: taken.append(writer.take_stored()) if blocks[0].header.height == 1 else None
    )
    writer.add_listener(lambda *_: taken.append(writer.take_stored()))
    writer.store([_block(1)], PROOF)
    await _let_run()
    assert taken == [opened[0], None]
    assert not hasattr(opened[0], "closed")
    writer._listeners.pop()
    writer.store([_block(2)], PROOF)
    await _let_run()
    assert opened[1].closed
    assert len(told) == 2
    await writer.stop()
    assert writer.take_stored() is None

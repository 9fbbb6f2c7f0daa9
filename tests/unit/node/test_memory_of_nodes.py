"""Nodes that forget, lie or cannot write: locked out until it is safe, suspended on the chain, back by themselves."""

from __future__ import annotations

import asyncio
from typing import Any

from consensus.chain.journal_records import encode_restored_record
from consensus.chain.messages import sign_vote
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode_stored_value, encode
from consensus.primitives.hashing import sha256
from node.p2p.wire import FrameKind
from tests.unit.node.small_nodes import MemoryJournal, SmallNodes, make_genesis, producer_key
from tests.virtual_time import in_virtual_time

NAMES = ["a", "b", "c", "d"]


async def _work(crowd: SmallNodes, node: str = "a", count: int = 1) -> None:
    for _ in range(count):
        await crowd.finalize(node, crowd.transaction("identity", "authenticate", bytes(32)))


async def _until(condition: Any, timeout_s: float = 120.0) -> None:
    async with asyncio.timeout(timeout_s):
        while not condition():  # noqa: ASYNC110 - what is waited for is many things, none of which tells
            await asyncio.sleep(0.01)


def _lockout(crowd: SmallNodes, name: str) -> dict[str, str] | None:
    found: dict[str, str] | None = crowd.nodes[name].describe()["lockout"]
    return found


@in_virtual_time
async def test_nodes_that_start_together_sign_after_one_exchange() -> None:
    crowd = await SmallNodes(make_genesis(NAMES)).start()
    assert all((_lockout(crowd, name) or {}).get("reason") == "asking" for name in NAMES)
    await asyncio.sleep(0.05)
    assert all(_lockout(crowd, name) is None for name in NAMES)
    await _work(crowd)
    await crowd.stop()


@in_virtual_time
async def test_a_restored_node_follows_and_is_silent_until_the_chain_went_on_without_it() -> None:
    crowd = await SmallNodes(make_genesis(NAMES)).start()
    await _work(crowd, count=3)
    await crowd.stop("d")
    crowd.journals["d"].records = [(0, encode_restored_record())]
    await crowd.start("d")
    await asyncio.sleep(0.1)
    found = _lockout(crowd, "d")
    assert found is not None
    assert found["reason"] == "restored"
    assert "is final without it" in found["until"]
    await _work(crowd, count=6)
    await _until(lambda: _lockout(crowd, "d") is None)
    await crowd.stop("c")
    await _work(crowd, "d", count=2)
    await crowd.stop()


@in_virtual_time
async def test_an_old_journal_is_noticed_without_the_flag() -> None:
    crowd = await SmallNodes(make_genesis(NAMES)).start()
    await _work(crowd, count=2)
    old = list(crowd.journals["b"].records)
    await _work(crowd, count=4)
    await crowd.stop("b")
    crowd.journals["b"].records = old
    await crowd.start("b")
    await asyncio.sleep(0.1)
    found = _lockout(crowd, "b")
    assert found is not None
    assert found["reason"] == "outdated"
    await _work(crowd, count=6)
    await _until(lambda: _lockout(crowd, "b") is None)
    await crowd.stop()


@in_virtual_time
async def test_a_producer_that_votes_twice_is_suspended_on_the_chain() -> None:
    """Every honest node has the evidence; one accusation is enough."""
    crowd = await SmallNodes(make_genesis([*NAMES, "e"])).start()
    await _work(crowd)
    node = crowd.nodes["a"]
    epoch, round_number = node.core.epoch, node.core.round + 1
    index = node.engine.epoch.schedule.index_of(producer_key("e").public_key)
    assert index is not None
    for name in NAMES:
        for block_id in (sha256(b"one block"), sha256(b"another")):
            vote = sign_vote(producer_key("e"), crowd.genesis.chain_id, epoch, round_number, block_id, index)
            crowd.nodes[name].peers.peer_frame("e", FrameKind.VOTE, encode(vote))
    assert all(len(crowd.nodes[name].evidence_submitter.pending) == 1 for name in NAMES)
    await crowd.wait_epoch(1)
    key = b"producers\x00candidate/" + producer_key("e").public_key
    with crowd.nodes["b"].finalized.snapshot() as snapshot:
        data = snapshot.get(key)
        assert data is not None
        entry = decode_stored_value(data)
    assert (entry["status"], entry["evidence"]["round"]) == ("suspended", round_number)
    assert producer_key("e").public_key not in node.engine.epoch.schedule.producers
    await _until(lambda: not any(crowd.nodes[name].evidence_submitter.pending for name in NAMES))
    await _work(crowd, "c")
    await crowd.stop()


class FullJournal(MemoryJournal):
    """A voting journal whose disk can be full."""

    is_full = False

    def sync(self) -> int:
        self._require_room()
        return super().sync()

    def recover(self, keep: Any) -> None:
        self._require_room()
        super().recover(keep)

    def _require_room(self) -> None:
        if self.is_full:
            raise BlockRobotError("JOURNAL_UNWRITABLE", "The disk is full.")


@in_virtual_time
async def test_a_node_whose_journal_disk_was_full_takes_part_again_by_itself() -> None:
    crowd = SmallNodes(make_genesis(NAMES))
    crowd.journals["c"] = full = FullJournal()
    await crowd.start()
    await _work(crowd)
    full.is_full = True
    await _work(crowd, count=3)
    node = crowd.nodes["c"]
    assert node.engine.fault == "The disk is full."
    assert not node.is_ready()
    with node.finalized.snapshot() as snapshot:
        assert snapshot.header.height >= 1
    await asyncio.sleep(30)
    assert len(node.engine._events) < 100
    full.is_full = False
    await _until(lambda: not node.engine.fault)
    await crowd.stop("a")
    await _work(crowd, "c", count=2)
    assert len(crowd.newest_common()) == 1
    await crowd.stop()


@in_virtual_time
async def test_a_node_whose_ledger_disk_was_full_takes_part_again_by_itself() -> None:
    crowd = await SmallNodes(make_genesis(NAMES)).start()
    await _work(crowd)
    ledger, node = crowd.ledgers["c"], crowd.nodes["c"]
    commit = ledger.commit

    async def refuse(*_: Any) -> Any:
        raise BlockRobotError("STORAGE_FULL", "The disk is full.")

    ledger.commit = refuse  # type: ignore[method-assign]
    await _work(crowd, count=3)
    await _until(lambda: node.engine.fault)
    ledger.commit = commit  # type: ignore[method-assign]
    await _until(lambda: not node.engine.fault)
    await crowd.stop("a")
    await _work(crowd, "c", count=2)
    await crowd.stop()


@in_virtual_time
async def test_a_node_is_stopped_while_its_disks_refuse() -> None:
    crowd = SmallNodes(make_genesis(NAMES))
    crowd.journals["c"] = full = FullJournal()
    await crowd.start()
    await _work(crowd)
    full.is_full = True
    await _work(crowd, count=2)
    assert crowd.nodes["c"].engine.fault
    await crowd.stop()

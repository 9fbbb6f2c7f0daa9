"""Execution finds boundaries out by itself: the header must name what the block's own writes decide, nothing else."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Any

import msgspec
import pytest

from consensus.chain.block import Block, EpochProof, FinalityProof, Header, QuorumCertificate, genesis_certificate
from consensus.chain.epoch_settings import Epoch, compute_epoch_hash
from consensus.chain.messages import sign_block
from consensus.chain.transaction import Transaction, sign_transaction
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode, encode, encode_value
from consensus.primitives.hashing import sha256
from consensus.protocol.effects import BuildBlock
from consensus.state.producers import EPOCH
from node.execution.block_executor import ExecutedBlock, Executor
from node.mempool.transaction_cache import TransactionCache
from node.storage.memory_store import MemoryStore
from tests.unit.node.hand_made_chain import KEYS, START_MS, make_genesis, stored
from tests.unit.node.written_chain import WritingMachine

GENESIS = make_genesis()
NEXT = msgspec.structs.replace(GENESIS.epoch, number=1, producers=GENESIS.epoch.producers[:3])
PROOF = FinalityProof(b"", b"", QuorumCertificate(epoch=0, round=2, block_id=b"", votes=()))


def _change(epoch: Epoch = NEXT) -> Transaction:
    fields = msgspec.structs.asdict(epoch) | {"settings": msgspec.structs.asdict(epoch.settings), "height": 1}
    return _transaction([[EPOCH.flat, encode_value(fields)]])


def _transaction(writes: list[Any]) -> Transaction:
    return sign_transaction(
        KEYS[0],
        chain_id=GENESIS.chain_id,
        contract="producers",
        entry="change",
        arguments=writes,
        valid_until_ms=START_MS + 60_000,
        salt=sha256(repr(writes).encode())[:8],
    )


@pytest.fixture
async def executor() -> AsyncIterator[Executor]:
    ledger = MemoryStore()
    await ledger.commit([stored(GENESIS.block())], b"")
    cache = TransactionCache()
    executor = Executor(genesis=GENESIS, ledger=ledger, machine=WritingMachine(), cache=cache, key=KEYS[1])
    yield executor
    executor.close()


def _order(parent: Header, parent_id: bytes, epoch: int = 0) -> BuildBlock:
    return BuildBlock(
        epoch=epoch,
        round=parent.round + 1,
        height=parent.height + 1,
        parent_id=parent_id,
        parent_timestamp_ms=parent.timestamp_ms,
        qc=genesis_certificate(parent_id),
        tc=None,
        producer=1,
        empty=False,
    )


def _build(executor: Executor, parent: ExecutedBlock | None, *transactions: Transaction) -> ExecutedBlock:
    header = GENESIS.block().header if parent is None else parent.header
    order = _order(header, GENESIS.block_id if parent is None else parent.block_id)
    built, faulty = executor.build(order, header.timestamp_ms + 1, list(transactions))
    assert not faulty
    return built


def _changed(block: Block, **changes: Any) -> Block:
    header = encode(msgspec.structs.replace(block.header, **changes))
    signature = sign_block(KEYS[1], GENESIS.chain_id, 0, block.header.round, sha256(header))
    return Block(header, signature, block.transactions)


def _refusal(executor: Executor, block: Block) -> str:
    with pytest.raises(BlockRobotError) as refusal:
        executor.verify(block)
    return refusal.value.code


def test_a_boundary_names_the_next_epoch_and_is_recognised_by_whoever_executes_it(executor: Executor) -> None:
    built = _build(executor, None, _change())
    assert built.header.next_schedule_hash == compute_epoch_hash(NEXT)
    assert (built.next_epoch, built.header.is_closing) == (NEXT, False)
    ordinary = _build(executor, None, _transaction([[b"records\x00a", b"1"]]))
    assert (ordinary.header.next_schedule_hash, ordinary.next_epoch) == (None, None)
    block = _build(executor, None, _change()).block
    executor._blocks.clear()
    assert executor.verify(block).next_epoch == NEXT


@pytest.mark.parametrize("named", [None, bytes(32), compute_epoch_hash(GENESIS.epoch)])
def test_a_boundary_that_names_another_epoch_or_none_is_refused(executor: Executor, named: bytes | None) -> None:
    block = _changed(_build(executor, None, _change()).block, next_schedule_hash=named)
    assert _refusal(executor, block) == "BLOCK_INVALID"


def test_a_block_that_changes_nothing_names_no_epoch_and_closes_only_behind_a_boundary(executor: Executor) -> None:
    block = _changed(_build(executor, None).block, next_schedule_hash=compute_epoch_hash(NEXT))
    assert _refusal(executor, block) == "BLOCK_INVALID"
    assert _refusal(executor, _changed(_build(executor, None).block, is_closing=True)) == "BLOCK_INVALID"


def test_behind_a_boundary_stand_empty_closing_blocks_only(executor: Executor) -> None:
    boundary = _build(executor, None, _change())
    first = _build(executor, boundary)
    second = _build(executor, first)
    for closing in (first, second):
        assert closing.header.is_closing
        assert closing.header.state_root == boundary.header.state_root
        assert closing.next_epoch is None
        executor._blocks.pop(closing.block_id)
        assert executor.verify(closing.block).header.is_closing
    assert _refusal(executor, _changed(second.block, is_closing=False, timestamp_ms=START_MS + 9)) == "BLOCK_INVALID"
    full = _changed(second.block, timestamp_ms=START_MS + 8)
    full = msgspec.structs.replace(full, transactions=(_transaction([]).wire,))
    assert _refusal(executor, full) == "BLOCK_INVALID"


def test_the_blocks_of_an_epoch_that_is_over_are_forgotten(executor: Executor) -> None:
    boundary = _build(executor, None, _change())
    closing = _build(executor, boundary)
    executor.begin_epoch(GENESIS.schedule)
    assert executor.find(closing.block_id) is closing
    next_schedule = type(GENESIS.schedule).of(NEXT)
    executor.begin_epoch(next_schedule)
    assert executor.find(closing.block_id) is None
    assert executor.schedule is next_schedule


def test_a_boundary_goes_to_the_store_with_its_own_proof_and_never_with_anothers(executor: Executor) -> None:
    boundary = _build(executor, None, _change())
    own = msgspec.structs.replace(PROOF, header_bytes=boundary.block.header_bytes)
    proof = decode(boundary.to_stored(own).epoch_proof_bytes, EpochProof)
    assert (proof.finality, proof.epoch) == (own, NEXT)
    with pytest.raises(AssertionError, match="another block"):
        boundary.to_stored(PROOF)
    assert _build(executor, None).to_stored(PROOF).epoch_proof_bytes == b""

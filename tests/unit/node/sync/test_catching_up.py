"""Blocks that a machine executes ahead are held against their headers like all others, however few come back."""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass, field, replace

import msgspec
import pytest

from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from consensus.limits import BLOCK_GAS_MAX, BLOCK_SIZE_MAX_BYTES
from contracts.execution.results import BlockResult, ExpectedBlock
from contracts.state.view import Overlay, StateView
from node.execution.block_executor import Executor
from node.execution.execution_machines import CheckedBlock, Machine
from node.mempool.transaction_cache import TransactionCache
from node.storage.memory_store import MemoryStore
from node.sync.batch_execution import GROUP_BLOCKS_MAX_COUNT, CatchUp, grouped
from node.sync.block_ranges import CheckedRange
from tests.unit.node.written_chain import WritingMachine, WrittenChain


@dataclass
class RemoteMachine(WritingMachine):
    """Notes what it is asked for, and gives back at most `gives` results at once."""

    gives: int = 1_000
    groups: list[int] = field(default_factory=list)
    singles: list[int] = field(default_factory=list)
    spoils: int | None = None

    def verify_ahead(self, parent: StateView, blocks: Sequence[ExpectedBlock]) -> list[BlockResult]:
        self.groups.append(len(blocks))
        results: list[BlockResult] = []
        for block in blocks[: self.gives]:
            result = super().verify(parent, block.height, block.time_ms, block.transactions)
            parent = Overlay(parent, result.writes, result.page_writes, result.state_root)
            results.append(replace(result, gas_used=1) if block.height == self.spoils else result)
        return results

    def verify(
        self, parent: StateView, height: int, time_ms: int, transactions: Sequence[Transaction], **_: object
    ) -> BlockResult:
        self.singles.append(height)
        return super().verify(parent, height, time_ms, transactions)


@pytest.fixture
async def ledger() -> AsyncIterator[MemoryStore]:
    store = MemoryStore()
    yield store
    await store.close()


@pytest.fixture(scope="module")
def chain() -> WrittenChain:
    chain = WrittenChain()
    for _ in range(GROUP_BLOCKS_MAX_COUNT + 6):
        chain.extend()
    return chain


def checked_blocks(chain: WrittenChain, executor: Executor) -> list[CheckedBlock]:
    return [
        CheckedBlock(block, block.block_id, block.header, tuple(map(executor.read_transaction, block.transactions)))
        for block in chain.blocks[1:]
    ]


async def start(chain: WrittenChain, ledger: MemoryStore, machine: Machine) -> Executor:
    await ledger.commit(chain.stored[:1], b"")
    return Executor(genesis=chain.genesis, ledger=ledger, machine=machine, cache=TransactionCache(), key=None)


async def catch_up(chain: WrittenChain, ledger: MemoryStore, machine: Machine) -> list[bytes]:
    """Execute the whole chain; return the state roots."""
    executor = await start(chain, ledger, machine)
    work = CatchUp(ledger, executor)
    try:
        run = CheckedRange("peer", checked_blocks(chain, executor), chain.proof())
        return [executed.overlay.state_root for executed in work.execute(run)]
    finally:
        work.close()
        executor.close()


def roots(chain: WrittenChain) -> list[bytes]:
    return [block.header.state_root for block in chain.blocks[1:]]


async def test_a_machine_elsewhere_gets_many_blocks_at_once(chain: WrittenChain, ledger: MemoryStore) -> None:
    machine = RemoteMachine()
    assert await catch_up(chain, ledger, machine) == roots(chain)
    assert machine.groups == [GROUP_BLOCKS_MAX_COUNT, 6]
    assert machine.singles == []


async def test_what_it_does_not_give_back_is_executed_block_by_block(chain: WrittenChain, ledger: MemoryStore) -> None:
    machine = RemoteMachine(gives=5)
    assert await catch_up(chain, ledger, machine) == roots(chain)
    assert machine.singles == [*range(6, GROUP_BLOCKS_MAX_COUNT + 1), GROUP_BLOCKS_MAX_COUNT + 6]


async def test_what_came_out_otherwise_ahead_is_no_more_believed_than_from_a_single_block(
    chain: WrittenChain, ledger: MemoryStore
) -> None:
    with pytest.raises(BlockRobotError, match=r"^BLOCK_INVALID:"):
        await catch_up(chain, ledger, RemoteMachine(spoils=7))


async def test_a_machine_in_the_process_is_asked_block_by_block(chain: WrittenChain, ledger: MemoryStore) -> None:
    assert await catch_up(chain, ledger, WritingMachine()) == roots(chain)


async def test_no_group_holds_more_than_two_full_blocks(chain: WrittenChain, ledger: MemoryStore) -> None:
    executor = await start(chain, ledger, WritingMachine())
    blocks = checked_blocks(chain, executor)[:9]
    executor.close()
    full = [replace(one, header=msgspec.structs.replace(one.header, gas_used=BLOCK_GAS_MAX)) for one in blocks]
    half = [replace(one, header=msgspec.structs.replace(one.header, gas_used=BLOCK_GAS_MAX // 2)) for one in blocks]
    long = [replace(one, transactions=one.transactions * 1_500) for one in blocks]
    assert sum(len(transaction.wire) for transaction in long[0].transactions) * 2 > BLOCK_SIZE_MAX_BYTES
    assert [len(group) for group in grouped(full)] == [1] * 9
    assert [len(group) for group in grouped(half)] == [2, 2, 2, 2, 1]
    assert max(len(group) for group in grouped(long)) <= 2
    assert [one for group in grouped(half) for one in group] == half

"""Blocks: calls one after another, failures without a trace, limits, and faults that decide nothing."""

from __future__ import annotations

from typing import Any

import pytest

from consensus.chain.block import Receipt, compute_receipts_root
from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from consensus.limits import BLOCK_GAS_MAX, BLOCK_SIZE_MAX_BYTES
from consensus.primitives.encoding import decode_value, encode_value
from consensus.state.keys import Reader
from contracts.execution.call_host import CallHost
from contracts.execution.contract_machine import ContractMachine
from contracts.execution.executor import WIRE_BYTES_A_GAS, execute_block
from contracts.execution.results import BlockContext, BlockResult, ExecutionLimits
from contracts.execution.views import run_view
from contracts.lifecycle.catalogue import ActiveContracts, Catalogue
from contracts.state.trie import compute_root
from contracts.state.view import MemoryState, Overlay, StateView
from contracts.vm import CompiledContract, InternalFault, compile_contract
from tests.unit.contracts.privacy.hospital import Hospital, key_of

COUNTER = '''
@export
def add(name: str, amount: int):
    """Add to a counter."""
    key = b"counter/" + name.encode()
    state.put(key, state.get(key, 0) + amount)
    emit("added", {"name": name})
    require(amount != 13, "UNLUCKY", "Not thirteen.")


@export
def drop(name: str):
    """Remove a counter."""
    state.delete(b"counter/" + name.encode())


@export
def list_into(name: str):
    """Store the names of all counters as this call sees them."""
    state.put(b"counter/temporary", 1)
    found = [entry[0] for entry in state.scan(b"counter/", 3)]
    state.put(b"list/" + name.encode(), found)


@export
def spin():
    """Never end."""
    while True:
        pass


@view
def read(name: str) -> int:
    """Return a counter."""
    require(state.has(b"counter/" + name.encode()), "NO_COUNTER", "There is no such counter.")
    return state.get(b"counter/" + name.encode())
'''


class Bench:
    """A chain of one small contract."""

    def __init__(self) -> None:
        self.hospital = Hospital()
        self.contracts: dict[str, CompiledContract] = {"counter": compile_contract(COUNTER, "counter")}
        self.state = MemoryState()

    def call(self, entry: str, *arguments: Any, contract: str = "counter") -> Transaction:
        return self.hospital.sign(key_of("anyone"), contract, entry, *arguments)

    def context(self) -> BlockContext:
        return BlockContext(chain_id=self.hospital.chain_id, height=7, time_ms=1_000)

    def run(self, *transactions: Transaction, parent: StateView | None = None, **options: Any) -> BlockResult:
        return execute_block(parent or self.state, self.contracts, self.context(), transactions, **options)


class OneContract(Catalogue):
    """Finds the same contracts on every state."""

    def __init__(self, contracts: dict[str, CompiledContract]) -> None:
        super().__init__()
        self.contracts = ActiveContracts(contracts, {})

    def active(self, state: Reader) -> ActiveContracts:
        return self.contracts


@pytest.fixture
def bench() -> Bench:
    return Bench()


def _codes(result: BlockResult) -> list[str]:
    return [receipt.code for receipt in result.receipts]


def test_calls_see_what_earlier_calls_of_the_block_wrote(bench: Bench) -> None:
    result = bench.run(bench.call("add", "a", 1), bench.call("add", "a", 2), bench.call("add", "b", 5))
    assert _codes(result) == ["OK", "OK", "OK"]
    assert decode_value(result.writes[b"counter\x00counter/a"] or b"") == 3
    assert result.state_root == compute_root((key, value) for key, value in result.writes.items() if value is not None)
    assert result.receipt_root == compute_receipts_root(result.receipts)
    assert result.gas_used == sum(receipt.gas_used for receipt in result.receipts)
    assert bench.state.get(b"counter\x00counter/a") is None


def test_a_failed_call_leaves_its_receipt_only(bench: Bench) -> None:
    result = bench.run(bench.call("add", "a", 1), bench.call("add", "a", 13), bench.call("add", "a", 2))
    assert _codes(result) == ["OK", "UNLUCKY", "OK"]
    failed: Receipt = result.receipts[1]
    assert (failed.ok, failed.events, failed.message) == (False, (), "Not thirteen.")
    assert failed.line == 8
    assert failed.gas_used > 0
    assert decode_value(result.writes[b"counter\x00counter/a"] or b"") == 3
    assert [event.name for event in result.receipts[0].events] == ["added"]


@pytest.mark.parametrize(
    ("entry", "arguments", "contract", "code"),
    [
        ("add", (), "counter", "ARGUMENTS_INVALID"),
        ("add", ("a", "1"), "counter", "ARGUMENTS_INVALID"),
        ("read", ("a",), "counter", "ENTRY_UNKNOWN"),
        ("nothing", (), "counter", "ENTRY_UNKNOWN"),
        ("add", ("a", 1), "no-such", "CONTRACT_UNKNOWN"),
    ],
)
def test_a_call_that_cannot_be_made_fails_with_a_receipt(
    bench: Bench, entry: str, arguments: tuple[Any, ...], contract: str, code: str
) -> None:
    result = bench.run(bench.call(entry, *arguments, contract=contract))
    assert _codes(result) == [code]
    assert result.writes == {}
    assert result.state_root == bench.state.state_root
    assert result.gas_used > 0


def test_an_endless_call_costs_its_limit_and_bytes_alone_may_use_it_up(bench: Bench) -> None:
    limits = ExecutionLimits(call_gas=10_000, block_gas=30_000)
    result = bench.run(bench.call("spin"), bench.call("add", "a", 1), limits=limits)
    assert _codes(result) == ["OUT_OF_GAS", "OK"]
    assert result.receipts[0].gas_used == 10_000
    limits = ExecutionLimits(call_gas=100)
    for contract in ("counter", "nothing"):
        receipt = bench.run(bench.call("drop", "n" * 10_000, contract=contract), limits=limits).receipts[0]
        assert (receipt.ok, receipt.gas_used) == (False, 100)


def test_a_leader_stops_where_the_block_is_full_and_a_voter_refuses(bench: Bench) -> None:
    transactions = [bench.call("add", "a", 1) for _ in range(10)]
    one = bench.run(transactions[0]).gas_used
    limits = ExecutionLimits(block_gas=4 * one)
    result = bench.run(*transactions, limits=limits, leader=True)
    assert len(result.receipts) < 10
    assert result.gas_used <= limits.block_gas
    assert result.left_out == tuple(item.txid for item in transactions[len(result.receipts) :])
    assert result.faulty == ()
    with pytest.raises(BlockRobotError, match="BLOCK_INVALID"):
        bench.run(*transactions, limits=limits)
    same = bench.run(*transactions[: len(result.receipts)], limits=limits)
    assert (same.state_root, same.receipt_root) == (result.state_root, result.receipt_root)


def test_a_block_takes_only_so_many_transactions(bench: Bench) -> None:
    transactions = [bench.call("add", "a", 1) for _ in range(3)]
    limits = ExecutionLimits(transactions_count=2)
    assert len(bench.run(*transactions, limits=limits, leader=True).receipts) == 2
    with pytest.raises(BlockRobotError, match="BLOCK_INVALID"):
        bench.run(*transactions, limits=limits)


class BrokenState(MemoryState):
    """A store that fails on one key, as nobody foresaw."""

    def get(self, key: bytes) -> bytes | None:
        if key.endswith(b"broken"):
            raise OSError("the disk is gone")
        return super().get(key)


def test_an_unforeseen_failure_never_decides_a_result(bench: Bench) -> None:
    state = BrokenState()
    before, broken, after = (bench.call("add", name, 1) for name in ("a", "broken", "b"))
    with pytest.raises(InternalFault):
        bench.run(before, broken, after, parent=state)
    result = bench.run(before, broken, after, parent=state, leader=True)
    assert [receipt.txid for receipt in result.receipts] == [before.txid, after.txid]
    assert result.left_out == result.faulty == (broken.txid,)
    assert set(result.writes) == {b"counter\x00counter/a", b"counter\x00counter/b"}


def test_the_machine_builds_what_it_verifies(bench: Bench) -> None:
    machine = ContractMachine(bench.hospital.chain_id, OneContract(bench.contracts))
    transactions = [bench.call("add", "a", number) for number in range(5)]
    built, faulty = machine.build(bench.state, 7, 1_000, transactions)
    assert faulty == []
    assert machine.verify(bench.state, 7, 1_000, transactions) == built
    broken = bench.call("add", "broken", 1)
    _, faulty = machine.build(BrokenState(), 7, 1_000, [broken])
    assert faulty == [broken.txid]
    with pytest.raises(InternalFault):
        machine.verify(BrokenState(), 7, 1_000, [broken])


def test_blocks_execute_on_overlays_as_on_the_stored_state(bench: Bench) -> None:
    first = bench.run(bench.call("add", "a", 1), bench.call("add", "b", 1))
    overlay = Overlay(bench.state, first.writes, first.page_writes, first.state_root)
    transactions = [bench.call("drop", "a"), bench.call("add", "b", 4), bench.call("list_into", "x")]
    above = bench.run(*transactions, parent=overlay)
    bench.state.absorb(first.writes, first.page_writes, first.state_root)
    assert bench.run(*transactions) == above
    assert decode_value(above.writes[b"counter\x00list/x"] or b"") == [b"counter/b", b"counter/temporary"]


def test_what_is_deleted_is_gone_from_root_and_scan(bench: Bench) -> None:
    result = bench.run(bench.call("add", "a", 1), bench.call("drop", "a"))
    assert result.writes == {b"counter\x00counter/a": None}
    assert result.state_root == bench.state.state_root


def test_a_scan_merges_parent_block_and_call_in_key_order() -> None:
    state = MemoryState()
    state.apply({b"p/%d" % number: encode_value(number) for number in range(0, 10, 2)})
    host = CallHost(state)
    host.begin()
    host.put(b"p/1", b"\x01")
    host.delete(b"p/2")
    host.keep()
    host.begin()
    host.put(b"p/3", b"\x03")
    host.delete(b"p/0")
    host.put(b"p/2", b"\x22")
    host.put(b"q/0", b"\x00")
    assert [key for key, _ in host.scan(b"p/", 4)] == [b"p/1", b"p/2", b"p/3", b"p/4"]
    assert host.scan(b"p/2", 10) == [(b"p/2", b"\x22")]
    host.begin()
    assert [key for key, _ in host.scan(b"p/", 3)] == [b"p/0", b"p/1", b"p/4"]


def test_views_answer_and_change_nothing(bench: Bench) -> None:
    done = bench.run(bench.call("add", "a", 4))
    bench.state.absorb(done.writes, done.page_writes, done.state_root)
    assert run_view(bench.state, bench.contracts, bench.context(), "counter", "read", ["a"]) == 4
    for contract, view in (("counter", "add"), ("counter", "none"), ("none", "read")):
        with pytest.raises(BlockRobotError, match="TRANSACTION_CONTRACT_UNKNOWN"):
            run_view(bench.state, bench.contracts, bench.context(), contract, view, ["a"])
    with pytest.raises(BlockRobotError, match="NO_COUNTER"):
        run_view(bench.state, bench.contracts, bench.context(), "counter", "read", ["b"])
    with pytest.raises(BlockRobotError, match="OUT_OF_GAS"):
        run_view(bench.state, bench.contracts, bench.context(), "counter", "read", ["a"], gas_limit=60)


def test_a_full_block_of_junk_takes_half_of_a_blocks_gas(bench: Bench) -> None:
    """Bytes stay on every node for a year, though the call that they are for comes to nothing."""
    junk = bench.call("x", b"x" * 15_900, contract="nothing")
    assert BLOCK_GAS_MAX // 2 < bench.run(junk).gas_used * (BLOCK_SIZE_MAX_BYTES // len(junk.wire)) <= BLOCK_GAS_MAX


@pytest.mark.parametrize(("contract", "entry"), [("nothing", "x"), ("counter", "x"), ("counter", "drop")])
def test_each_call_pays_for_its_bytes(bench: Bench, contract: str, entry: str) -> None:
    call = bench.call(entry, "n" * 10_000, contract=contract)
    assert bench.run(call).gas_used > len(call.wire) // WIRE_BYTES_A_GAS

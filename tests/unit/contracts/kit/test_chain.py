"""The kit's chain: it does what a network does, and says why something failed."""

from __future__ import annotations

from pathlib import Path

import pytest

from consensus.chain.block import Receipt
from consensus.chain.transaction import sign_transaction
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode_value
from contracts.execution.executor import WIRE_BYTES_A_GAS, execute_block
from contracts.execution.results import BlockContext
from contracts.kit import CallFailedError, Chain
from contracts.state.view import MemoryState
from contracts.vm import compile_contract
from tests.unit.contracts.system.consortium import key_of

COUNTER = '''"""A counter, and what a test wants to see."""

LIMIT = 5


def check(total: int):
    require(total <= LIMIT, "TOO_FAR", f"It counts to {LIMIT}, not to {total}.")


@export
def add(step: int, parts: list) -> list:
    total = state.get(b"total", 0)
    for part in parts:
        total += part * step
        check(total)
    state.put(b"total", total)
    emit("added", {"total": total, "by": ctx.caller})
    return [total, ctx.height, ctx.time]


@export
def twice(other: str) -> list:
    return (call(other, "add", 1, [1]), ctx.calling_contract)


@view
def total() -> int:
    return state.get(b"total", 0)


@genesis
def begin(total: int):
    state.put(b"total", total)
'''
NEXT_VERSION = (
    COUNTER.replace("LIMIT = 5", "LIMIT = 50")
    + """

@migrate
def carry_over():
    require(state.get(b"total") != 3, "THREE", "Three cannot be carried over.")
    state.put(b"total", state.get(b"total") * 10)
    state.put(b"by", ctx.caller)
    emit("carried", {})
"""
)


@pytest.fixture
def chain() -> Chain:
    chain = Chain()
    chain.deploy_source(COUNTER, "counter")
    return chain


def test_each_call_is_in_a_block_of_its_own(chain: Chain) -> None:
    height, time_ms = chain.height, chain.time_ms
    first = chain.call("counter", "add", 1, [1], caller="alice")
    assert first.result == [1, height, time_ms]
    chain.advance(blocks=10, days=1, hours=1, minutes=1, seconds=1, ms=1)
    second = chain.call("counter", "add", 1, [1])
    assert second.result == [2, height + 11, time_ms + 1_000 + 90_061_001]
    assert first.txid != second.txid
    assert [(event.name, event.height) for event in chain.events] == [("added", height), ("added", height + 11)]
    assert chain.events[0].data == {"total": 1, "by": chain.caller("alice").key}
    assert chain.state("counter") == {b"total": 2}


def test_it_does_what_a_block_does(chain: Chain) -> None:
    """The same call, executed as a node executes it: the same events, state and root; its bytes cost gas besides."""
    alice = chain.caller("alice")
    called = chain.call("counter", "add", 2, [1, 1], caller=alice)
    transaction = sign_transaction(
        alice.private_key,
        chain_id=chain.chain_id,
        contract="counter",
        entry="add",
        arguments=[2, [1, 1]],
        valid_until_ms=1,
        salt=bytes(8),
    )
    context = BlockContext(chain.chain_id, chain.height - 1, chain.time_ms - 1_000)
    block = execute_block(MemoryState(), {"counter": compile_contract(COUNTER, "counter")}, context, [transaction])
    receipt: Receipt = block.receipts[0]
    gas = called.gas_used + len(transaction.wire) // WIRE_BYTES_A_GAS
    assert (receipt.code, receipt.gas_used, block.state_root) == ("OK", gas, chain.state_root)
    assert [decode_value(event.data) for event in receipt.events] == [event.data for event in called.events]


def test_a_failed_call_shows_the_lines_that_ran_with_values(chain: Chain) -> None:
    with pytest.raises(CallFailedError) as failure:
        chain.call("counter", "add", 2, [1, 2], caller="alice")
    lines = str(failure.value).splitlines()
    assert lines[0] == "counter.add failed."
    assert lines[1].startswith("counter.add(2, [1, 2]) by alice in block 1: TOO_FAR, ")
    assert lines[-1] == "  failed at line 7: TOO_FAR: It counts to 5, not to 6."
    assert "total += part * step" in lines[-5]
    assert "total = 6" in lines[-5]
    assert chain.state("counter") == {}
    assert chain.events == []
    steps = failure.value.trace.document()["steps"]
    assert [(step["function"], step["line"]) for step in steps][-3:] == [("add", 14), ("add", 15), ("check", 7)]
    assert steps[0]["values"] == {"step": "2", "parts": "[1, 2]", "total": "0"}


def test_an_expected_failure_is_one_of_that_code(chain: Chain) -> None:
    failed = chain.expect_failure("TOO_FAR", "counter", "add", 6, [1])
    assert (failed.line, failed.message) == (7, "It counts to 5, not to 6.")
    with pytest.raises(CallFailedError, match="came to OK instead of TOO_FAR"):
        chain.expect_failure("TOO_FAR", "counter", "add", 1, [1])
    assert chain.view("counter", "total") == 0
    with pytest.raises(CallFailedError, match="came to ARGUMENTS_INVALID instead of TOO_FAR"):
        chain.expect_failure("TOO_FAR", "counter", "add", "6", [1])
    chain.expect_failure("ENTRY_UNKNOWN", "counter", "total")
    chain.expect_failure("ENTRY_UNKNOWN", "nothing", "at_all")


def test_contracts_call_each_other_and_tuples_become_lists(chain: Chain) -> None:
    other = chain.deploy_source(COUNTER, "other")
    assert other.call("twice", "counter") == [[1, 1, chain.time_ms - 1_000], ""]
    assert (chain.view("counter", "total"), other.view("total")) == (1, 0)
    assert other.state == {}
    assert other.events() == []


def test_genesis_entries_and_migrations_run_as_the_machine_runs_them(chain: Chain) -> None:
    chain.genesis("counter", "begin", 3)
    with pytest.raises(CallFailedError, match="THREE"):
        chain.deploy_source(NEXT_VERSION, "counter")
    chain.expect_failure("TOO_FAR", "counter", "add", 3, [1])
    chain.call("counter", "add", 1, [1])
    counter = chain.deploy_source(NEXT_VERSION, "counter")
    assert counter.view("total") == 40
    assert counter.state[b"by"] == bytes(33)
    assert counter.events("carried") == []
    assert counter.call("add", 1, [5])[0] == 45


def test_versions_are_counted_apart(chain: Chain) -> None:
    chain.call("counter", "add", 1, [1])
    chain.deploy_source(NEXT_VERSION, "counter")
    for _ in range(2):
        chain.call("counter", "add", 1, [1])
    first, second = chain.deployments
    assert (len(first.gas["add"]), len(second.gas["add"]), len(second.gas["carry_over"])) == (1, 2, 1)
    assert (first.lines[16].runs, second.lines[16].runs) == (1, 2)


def test_a_trace_may_be_had_without_a_call(chain: Chain) -> None:
    trace = chain.trace("counter", "add", 1, [1, 1], caller="alice")
    assert (trace.code, chain.state("counter")) == ("OK", {})
    assert "emit(" in trace.text()
    assert trace.gas_used == chain.call("counter", "add", 1, [1, 1], caller="alice").gas_used


def test_gas_of_lines_adds_up_to_the_gas_of_calls(chain: Chain) -> None:
    chain.deploy_source(COUNTER, "other")
    used = chain.call("counter", "add", 1, [1, 1]).gas_used
    used += chain.call("other", "twice", "counter").gas_used
    used += chain.expect_failure("TOO_FAR", "counter", "add", 9, [1]).gas_used
    lines = [deployment.lines for deployment in chain.deployments]
    assert sum(figures.gas for one in lines for figures in one.values()) == used
    assert lines[0][14].runs == 4
    assert lines[0][23].runs == 0


def test_deep_and_endless_calls_end_as_on_a_network(chain: Chain) -> None:
    source = "@export\ndef deep(n: int) -> int:\n    if n > 0:\n        return deep(n - 1)\n    return 0\n"
    endless = "\n\n@export\ndef endless():\n    n = 0\n    while True:\n        n += 1\n"
    contract = chain.deploy_source(source + endless, "deep")
    contract.expect_failure("CALL_DEPTH", "deep", 1_000)
    assert contract.expect_failure("OUT_OF_GAS", "endless").gas_used == 250_000


def test_a_long_trace_says_what_it_leaves_out(chain: Chain) -> None:
    source = '@export\ndef walk(n: int):\n    for i in range(n):\n        i += 1\n    require(n < 0, "END", "")\n'
    contract = chain.deploy_source(source, "walk")
    with pytest.raises(CallFailedError) as failure:
        contract.call("walk", 6_000)
    assert len(failure.value.trace.steps) == 5_000
    assert "... 1002 more statements" in str(failure.value)


def test_callers_are_the_same_on_every_chain_and_can_sign() -> None:
    alice = Chain().caller("alice")
    assert alice.key == Chain().caller("alice").key != Chain().caller("bob").key
    assert "private" not in repr(alice)
    source = '@view\ndef who(signature: bytes) -> bytes | None:\n    return recover("a/tag", signature, b"message")\n'
    contract = Chain().deploy_source(source, "who")
    assert contract.view("who", alice.sign("a/tag", b"message")) == alice.key
    assert alice.key != key_of("alice").public_key


def test_sources_are_files_beside_the_test(tmp_path: Path) -> None:
    (tmp_path / "counter.py").write_text(COUNTER, encoding="utf-8")
    chain = Chain(folder=tmp_path)
    assert chain.deploy("counter.py").name == "counter"
    assert chain.deploy("counter.py", "another").path == tmp_path / "counter.py"
    (tmp_path / "broken.py").write_text("import os\n", encoding="utf-8")
    with pytest.raises(BlockRobotError, match=r"^CONTRACT_SOURCE_INVALID:"):
        chain.deploy("broken.py")


def test_what_cannot_cross_the_border_is_refused(chain: Chain) -> None:
    with pytest.raises(BlockRobotError):
        chain.call("counter", "add", 1.5, [1])

"""An entry that carries a contract's state over to a new version: run by the machine, and by nobody else."""

from __future__ import annotations

import pytest

from contracts.vm.model.meter import MIGRATE_WRITES_MAX_COUNT

SOURCE = """
@export
def add(name: str):
    state.put(b"v2/" + name.encode(), True)

@migrate
def carry_over():
    for key, value in state.scan(b"v1/", 10):
        move(key, value)

def move(key, value):
    state.put(b"v2/" + key[3:], value)
    state.delete(key)

@view
def has(name: str) -> bool:
    return state.has(b"v2/" + name.encode())
"""


def test_the_machine_runs_it_and_its_writes_stay(bench):
    bench.deploy("old", '@export\ndef add(name: str):\n    state.put(b"v1/" + name.encode(), True)\n')
    assert bench.call("old.add", "anna").ok
    bench.host.entries = {key.replace(b"old", b"it"): value for key, value in bench.host.entries.items()}
    bench.deploy("it", SOURCE)
    outcome = bench.call("it.carry_over", mode="migrate")
    assert (outcome.ok, outcome.result) == (True, None)
    assert list(bench.host.entries) == [b"it\x00v2/anna"]
    assert bench.call("it.has", "anna", mode="view").result is True


@pytest.mark.parametrize("mode", ["export", "view", "genesis"])
def test_no_transaction_and_no_view_runs_it(bench, mode):
    bench.deploy("it", SOURCE)
    assert bench.call("it.carry_over", mode=mode).code == "ENTRY_UNKNOWN"


def test_no_other_contract_runs_a_migration_and_the_machine_nothing_else_as_one(bench):
    bench.deploy("it", SOURCE)
    bench.deploy("other", '@export\ndef f():\n    call("it", "carry_over")\n')
    assert bench.call("other.f").code == "ENTRY_UNKNOWN"
    bench.deploy("it", SOURCE)
    assert bench.call("it.add", "x", mode="migrate").code == "ENTRY_UNKNOWN"
    entry = bench.deploy("it", SOURCE).abi.entry("carry_over")
    assert (entry.kind, entry.params, entry.returns) == ("migrate", (), "object")


def test_it_may_write_more_than_a_transaction_and_not_without_end(bench):
    bench.gas_limit = 10_000_000
    text = "@view\ndef v():\n    pass\n\n@migrate\ndef m():\n    for i in range({}):\n        state.put(u32(i), i)\n"
    bench.deploy("it", text.format(MIGRATE_WRITES_MAX_COUNT))
    assert bench.call("it.m", mode="migrate").ok
    bench.deploy("it", text.format(MIGRATE_WRITES_MAX_COUNT + 1))
    assert bench.call("it.m", mode="migrate").code == "WRITE_BUDGET"


@pytest.mark.parametrize(
    ("migration", "line"),
    [
        ("@migrate\ndef m(version: int):\n    pass\n", 5),
        ("@migrate\ndef m() -> int:\n    pass\n", 5),
        ("@migrate\ndef m():\n    return 1\n", 6),
        ("@migrate\ndef m():\n    pass\n@migrate\ndef n():\n    pass\n", 8),
        ("@migrate\ndef m():\n    pass\n@export\ndef f():\n    m()\n", 9),
        ("@migrate\ndef m():\n    m()\n", 6),
    ],
)
def test_a_migration_is_refused_that(problems, migration, line):
    (problem,) = problems("@view\ndef v():\n    pass\n" + migration)
    assert (problem.code, problem.line) == ("MIGRATE", line)


def test_a_migration_may_leave_early_and_say_that_it_returns_nothing(bench):
    source = (
        "@view\ndef v():\n    pass\n@migrate\ndef m() -> None:\n    if state.has(b'done'):\n        return\n    pass\n"
    )
    bench.deploy("it", source)
    assert bench.call("it.m", mode="migrate").ok


def test_a_migration_alone_is_no_contract(problems):
    assert [one.code for one in problems("@migrate\ndef m():\n    pass\n")] == ["NO_ENTRY"]

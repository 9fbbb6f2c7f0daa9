"""A faulty version of `lifecycle` stops nothing, spoils nothing that the machine decides by, and goes by itself."""

from __future__ import annotations

from typing import Any

import pytest

from consensus.state.lifecycle import DUE
from contracts.execution.chain_refusals import read_limit
from contracts.lifecycle.changes import GOVERNING, TRIAL_MS, read_value
from contracts.lifecycle.describing import list_contracts, list_due
from contracts.lifecycle.registry import SHIPPED_CONTRACTS, compute_source_hash, read_source
from tests.unit.contracts.system.consortium import Consortium, key_of
from tests.unit.contracts.system.deploying import VISITORS, VISITORS_2, activation, agree, deploy, upgrade, upload

ANYONE = key_of("anyone")
SPOILING = '''

@export
def spoil(key: bytes, value: object):
    """Write anything anywhere."""
    if value is None:
        state.delete(key)
    else:
        state.put(key, value)
'''
ACTIVATION = {"kind": "activate", "name": "visitors", "version": 1, "from_height": 0, "from_ms": 0}
WRONG_ROWS = [
    5,
    {},
    ["activate"],
    {b"kind": "activate"},
    ACTIVATION | {"kind": "vanish"},
    ACTIVATION | {"kind": ["activate"]},
    ACTIVATION | {"name": b"visitors"},
    ACTIVATION | {"name": "machine"},
    ACTIVATION | {"name": "lifecycle\x00x"},
    ACTIVATION | {"name": "x" * 33},
    ACTIVATION | {"version": 0},
    ACTIVATION | {"version": True},
    ACTIVATION | {"version": 1 << 32},
    ACTIVATION | {"from_height": "0"},
    ACTIVATION | {"from_height": -1},
    ACTIVATION | {"from_ms": None},
    ACTIVATION | {"from_ms": 1 << 200},
    {field: value for field, value in ACTIVATION.items() if field != "from_ms"},
]


@pytest.fixture
def chain() -> Consortium:
    chain = Consortium(organisations=3, nodes=3)
    upgrade(chain, "visitors", VISITORS)
    return chain


def changed(old: str, new: str) -> str:
    source = read_source("lifecycle")
    assert old in source
    return source.replace(old, new)


def spoiled(chain: Consortium, **values: Any) -> None:
    """Put a version of `lifecycle` on trial that writes these values over its state."""
    upgrade(chain, "lifecycle", read_source("lifecycle") + SPOILING)
    for key, value in values.items():
        spoil(chain, key.encode(), value)


def spoil(chain: Consortium, key: bytes, value: Any) -> None:
    chain.must(ANYONE, "lifecycle", "spoil", key, value)


def version_in_force(chain: Consortium, name: str) -> int:
    return {row.name: row.version for row in list_contracts(chain.state)}[name]


def end_trial(chain: Consortium) -> None:
    chain.time_ms += TRIAL_MS
    chain.block([])


def require_works(chain: Consortium) -> None:
    """The first version of `lifecycle` is back, shows what is so, and changes contracts."""
    assert version_in_force(chain, "lifecycle") == 1
    assert list_due(chain.state) == chain.view("lifecycle", "changes_due") == []
    assert ["lifecycle", 1] in [row[:2] for row in chain.view("lifecycle", "contracts")]
    upgrade(chain, "others", VISITORS)
    chain.must(ANYONE, "others", "enter", "Ada")


def test_rows_with_another_field_are_ignored_and_the_version_that_writes_them_goes(chain: Consortium) -> None:
    upgrade(chain, "lifecycle", changed('"from_ms": 0', '"at_ms": 0'))
    deploy(chain, "lost", VISITORS)
    chain.block([])
    assert "lost" not in chain.contracts
    end_trial(chain)
    require_works(chain)


def test_a_version_that_forgets_what_is_due_still_goes(chain: Consortium) -> None:
    upgrade(chain, "lifecycle", changed('entry["name"] != name or entry["kind"] == "keep"]', "False]"))
    upgrade(chain, "visitors", VISITORS_2)
    assert [row.kind for row in list_due(chain.state)] == ["return"]
    end_trial(chain)
    require_works(chain)


@pytest.mark.parametrize("due", [7, "due", {"kind": "activate"}, WRONG_ROWS, [[[]]], b"\xc1"])
def test_whatever_stands_for_what_is_due_stops_nothing(chain: Consortium, due: Any) -> None:
    spoiled(chain, due=due)
    chain.block([])
    assert version_in_force(chain, "visitors") == 1
    assert "machine" not in chain.contracts
    assert [row.kind for row in list_due(chain.state)] == ["return"]
    end_trial(chain)
    require_works(chain)


def test_a_right_row_among_wrong_ones_takes_effect(chain: Consortium) -> None:
    upgrade(chain, "visitors", VISITORS_2)
    spoiled(chain, due=[*WRONG_ROWS, ACTIVATION | {"more": 1}])
    chain.block([])
    assert version_in_force(chain, "visitors") == 1


def test_a_row_that_waits_keeps_fields_of_later_versions(chain: Consortium) -> None:
    waiting = ACTIVATION | {"from_height": 1_000_000, "more": 1}
    spoiled(chain, due=[5, waiting])
    end_trial(chain)
    assert version_in_force(chain, "lifecycle") == 1
    assert read_value(chain.state, DUE.flat) == [waiting]


@pytest.mark.parametrize("value", [None, 7, [], {}, {"lifecycle": 1}, {"visitors": [9, b"", True]}])
def test_a_spoilt_table_or_list_of_trials_changes_nothing(chain: Consortium, value: Any) -> None:
    spoiled(chain, table=value, trials=value)
    chain.must(ANYONE, "visitors", "enter", "Ada")
    end_trial(chain)
    chain.must(ANYONE, "visitors", "enter", "Bob")
    require_works(chain)


@pytest.mark.parametrize("value", [None, 7, {}, {"source_hash": 7}, {"source_hash": bytes(32), "entries": [1]}])
def test_spoilt_entries_of_versions_stop_neither_calls_nor_the_return(chain: Consortium, value: Any) -> None:
    spoiled(chain)
    for name in ("lifecycle", "visitors"):
        for number in (1, 2):
            spoil(chain, b"version/" + name.encode() + b"/" + number.to_bytes(4, "big"), value)
    spoil(chain, b"versions/visitors", "three")
    wrong = chain.send(ANYONE, "visitors", "enter")
    assert (wrong.ok, wrong.code) == (False, "ARGUMENTS_INVALID")
    assert chain.send(ANYONE, "visitors", "vanish").code == "ENTRY_UNKNOWN"
    agreed = [ACTIVATION | {"version": 2}]
    spoil(chain, b"due", agreed)
    end_trial(chain)
    require_works(chain)


def test_a_spoilt_interface_explains_nothing(chain: Consortium) -> None:
    record = chain.view("lifecycle", "version", "visitors", 1)
    spoiled(chain)
    for kind in ("in\x00t", "(" * 3000, "list[", "thing"):
        record["entries"] = [["enter", "export", [["name", kind]], 1, "object"]]
        spoil(chain, b"version/visitors/" + bytes([0, 0, 0, 1]), record)
        assert "Version" not in chain.send(ANYONE, "visitors", "enter", 5).message


def test_a_source_in_force_is_out_of_its_reach(chain: Consortium) -> None:
    """A node that starts later compiles it from the state."""
    spoiled(chain)
    place = b"source/" + compute_source_hash(VISITORS)
    for key, value in ((place, None), (place + b"/" + bytes(4), b"other")):
        spoil(chain, key, value)
    restarted = type(chain.catalogue)()
    assert "visitors" in restarted.active(chain.state)


@pytest.mark.parametrize("entry", [None, 7, {"parts": "1"}, {"parts": 1 << 40}, {"parts": 2, "size_bytes": 1}])
def test_a_version_whose_source_is_gone_fails(chain: Consortium, entry: Any) -> None:
    spoiled(chain)
    deploy(chain, "others", VISITORS_2, delay=3)
    spoil(chain, b"source/" + compute_source_hash(VISITORS_2), entry)
    for _ in range(3):
        chain.block([])
    assert "others" not in chain.contracts
    assert chain.view("lifecycle", "version", "others", 1)["failure"].startswith("SOURCE_MISSING")


@pytest.mark.parametrize("data", [b"def f(:\n", b"\xff\xfe"])
def test_a_version_that_is_no_contract_fails(chain: Consortium, data: bytes) -> None:
    spoiled(chain)
    source_hash = _hash_of(data)
    record = chain.view("lifecycle", "version", "visitors", 1) | {"source_hash": source_hash}
    for key, value in (
        (b"source/" + source_hash, {"parts": 1, "size_bytes": len(data)}),
        (b"source/" + source_hash + b"/" + bytes(4), data),
        (b"version/visitors/" + bytes([0, 0, 0, 2]), record),
        (b"due", [ACTIVATION | {"version": 2}]),
    ):
        spoil(chain, key, value)
    chain.must(ANYONE, "visitors", "enter", "Ada")
    assert chain.view("lifecycle", "version", "visitors", 2)["failure"].startswith("SOURCE_")


def _hash_of(data: bytes) -> bytes:
    from contracts.vm.compiler.compile_cache import compute_source_hash as compute_hash_of_bytes

    return compute_hash_of_bytes(data)


def test_one_contract_changes_with_a_block_whatever_is_asked(chain: Consortium) -> None:
    upgrade(chain, "others", VISITORS)
    disabling = [ACTIVATION | {"kind": "disable", "name": name} for name in ("visitors", "others")]
    spoiled(chain, due=disabling)
    chain.block([])
    assert chain.contracts.disabled == {"visitors"}
    chain.block([])
    assert chain.contracts.disabled == {"visitors", "others"}


@pytest.mark.parametrize("name", GOVERNING)
def test_what_governs_is_not_disabled_whatever_is_asked(chain: Consortium, name: str) -> None:
    spoiled(chain, due=[ACTIVATION | {"kind": "disable", "name": name}])
    chain.block([])
    assert not chain.contracts.disabled


def test_what_governs_does_not_migrate_whatever_is_asked(chain: Consortium) -> None:
    upgrade(chain, "lifecycle", changed('require(not facts["migrates"]', "require(True"))
    migrating = read_source("forms") + '\n\n@migrate\ndef carry_over():\n    state.put(b"x", 1)\n'
    upgrade(chain, "forms", migrating)
    assert version_in_force(chain, "forms") == 1
    assert chain.view("lifecycle", "version", "forms", 2)["failure"].startswith("MIGRATION_REFUSED")


def test_a_decision_to_keep_a_version_that_is_no_more_keeps_nothing(chain: Consortium) -> None:
    spoiled(chain, due=[ACTIVATION | {"kind": "keep", "name": "lifecycle", "version": 3}])
    end_trial(chain)
    require_works(chain)


def test_machine_and_contract_name_the_same_governing_contracts_and_none_can_be_switched_off() -> None:
    assert read_limit("GOVERNING") == GOVERNING
    # Rights of people call each other's contracts, and what the network is run by: one without the others is nothing.
    assert set(SHIPPED_CONTRACTS) == set(GOVERNING)


def test_a_version_that_means_harm_can_have_itself_kept(chain: Consortium) -> None:
    """No rule of form tells a decision that was taken from one that was made up: the threat model says so."""
    spoiled(chain, due=[ACTIVATION | {"kind": "keep", "name": "lifecycle", "version": 2}])
    end_trial(chain)
    assert version_in_force(chain, "lifecycle") == 2


def test_another_version_of_a_kept_one_returns_to_it(chain: Consortium) -> None:
    """Its source was uploaded; the machine has it, whatever became of the upload."""
    spoiled(chain, due=[ACTIVATION | {"kind": "keep", "name": "lifecycle", "version": 2}])
    chain.block([])
    third = changed("NOTE_MAX_CHARS = 280", "NOTE_MAX_CHARS = 300") + SPOILING
    upgrade(chain, "lifecycle", third)
    second = read_source("lifecycle") + SPOILING
    spoil(chain, b"source/" + compute_source_hash(second), None)
    end_trial(chain)
    assert version_in_force(chain, "lifecycle") == 2
    upload(chain, key_of("org-01/admin"), VISITORS_2)
    agree(chain, "activate", activation("lifecycle", 1))
    chain.block([])
    assert version_in_force(chain, "lifecycle") == 1

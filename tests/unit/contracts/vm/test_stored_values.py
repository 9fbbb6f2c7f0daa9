"""Entries that many calls read: decoded once, and yet no reader ever sees what another did to its copy."""

from __future__ import annotations

import pytest

from consensus.primitives.encoding import encode_value
from contracts.vm.model import values

READER = """
@export
def f():
    first = state.get(b"key")
    second = state.get(b"key")
    if isinstance(first, dict):
        first["new"] = 1
        for name in first:
            item = first[name]
            if isinstance(item, list):
                item.append(1)
    if isinstance(first, list):
        first.append(1)
        if isinstance(first[0], list):
            first[0].append(1)
    return [first != second, second, state.get(b"key")]
"""

STORED = [
    {"a": b"x" * 40, "b": "text", "c": 5, "d": None, "e": True},
    {"a": b"x" * 40, "b": [1, 2]},
    {"a": {"b": {"c": "quite a long text"}}},
    [b"x" * 40, 1, "a"],
    [[1, 2, 3], b"x" * 40],
    list(range(100)),
]


@pytest.fixture(autouse=True)
def _forget():
    values._decoded.clear()
    yield
    values._decoded.clear()


@pytest.mark.parametrize("stored", STORED)
def test_what_one_reader_changes_no_other_sees(bench, stored):
    bench.deploy("it", READER)
    bench.host.entries[b"it\x00key"] = encode_value(stored)
    for _ in range(3):
        assert bench.call("it.f").result == [True, stored, stored]


@pytest.mark.parametrize("stored", [*STORED, b"x" * 100, "é" * 50, 1 << 200, None])
def test_an_entry_read_before_costs_what_it_cost_the_first_time(bench, stored):
    bench.deploy("it", READER)
    bench.host.entries[b"it\x00key"] = encode_value(stored)
    first = bench.call("it.f")
    assert [bench.call("it.f") for _ in range(2)] == [first, first]
    values._decoded.clear()
    assert bench.call("it.f") == first


def test_the_memory_of_decoded_entries_is_bounded(bench):
    bench.deploy("it", READER)
    for number in range(values._KEPT_MAX_COUNT + 50):
        bench.host.entries[b"it\x00key"] = encode_value({"number": number, "more": "text"})
        bench.call("it.f")
        assert len(values._decoded) <= values._KEPT_MAX_COUNT
    bench.host.entries[b"it\x00key"] = encode_value(b"x" * (values._KEPT_MAX_BYTES + 1))
    before = dict(values._decoded)
    bench.call("it.f")
    assert values._decoded == before

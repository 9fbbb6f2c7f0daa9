"""The quick way of storing a dict and the plain walk agree: on the bytes, on the charge, on what is refused."""

from __future__ import annotations

from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from consensus.primitives.encoding import encode_value
from contracts.vm.model import dict_shapes
from contracts.vm.model.faults import Fault
from contracts.vm.model.meter import CallContext, Runtime
from contracts.vm.model.values import encode_checked

CONTEXT = CallContext(caller=b"", height=0, time_ms=0, txid=b"", chain_id=b"")
keys = st.one_of(st.sampled_from(["a", "b", "status", b"a", b"", 1, -1, 300]), st.text("abé", max_size=4))
scalars = st.one_of(st.none(), st.booleans(), st.integers(-(2**256) + 1, 2**256 - 1))
texts = st.one_of(st.text("xyzé", max_size=30), st.binary(max_size=30))
empties = st.sampled_from([[], (), {}])
items = st.one_of(scalars, texts, empties, st.lists(scalars, max_size=2), st.just(range(3)))
dicts = st.dictionaries(keys, items, max_size=40)


def new_runtime(gas: int) -> Runtime:
    return Runtime(None, CONTEXT, gas, None, None, read_only=False)  # type: ignore[arg-type]


def encode(value: dict[Any, Any], gas: int, size_max: int, *, quickly: bool) -> Any:
    """Return what encoding gives and what is left of the gas; quickly or by the walk alone."""
    runtime = new_runtime(gas)
    given_up = dict_shapes._KEYS_MAX_COUNT
    dict_shapes._KEYS_MAX_COUNT = given_up if quickly else -1
    try:
        return encode_checked(runtime, value, size_max, "A value"), runtime.gas
    except Fault as fault:
        return fault.code, fault.message, None if fault.code == "OUT_OF_GAS" else runtime.gas
    finally:
        dict_shapes._KEYS_MAX_COUNT = given_up


@given(dicts, st.integers(0, 200), st.integers(0, 300))
def test_the_quick_way_and_the_walk_agree(value, gas, size_max):
    quick = encode(value, gas, size_max, quickly=True)
    assert quick == encode(value, gas, size_max, quickly=False)
    assert quick == encode(value, gas, size_max, quickly=True)
    if isinstance(quick[0], bytes):
        assert quick[0] == encode_value(value)


@given(st.dictionaries(st.text("abc", min_size=1, max_size=6), st.one_of(texts, st.integers(0, 99)), max_size=20))
def test_plain_dicts_take_the_quick_way(value):
    assert dict_shapes.encode_by_shape(new_runtime(1000), value, 10_000) == encode_value(value)


def test_the_memory_of_shapes_is_bounded_and_names_between_two_kinds_keep_both():
    for number in range(dict_shapes._SHAPES_MAX_COUNT + 20):
        dict_shapes.encode_by_shape(new_runtime(1000), {f"key{number}": number}, 1000)
        assert len(dict_shapes._latest) <= len(dict_shapes._shapes) <= dict_shapes._SHAPES_MAX_COUNT
    assert dict_shapes.encode_by_shape(new_runtime(1000), {"x" * 2000: 1}, 10_000) is None
    for value in [{"a": 1, "b": b"x"}, {"a": b"x", "b": 1}] * 3:
        assert dict_shapes.encode_by_shape(new_runtime(1000), value, 1000) == encode_value(value)
    kinds = [kinds for names, kinds in dict_shapes._shapes if names == ("a", "b")]
    assert sorted(map(str, kinds)) == sorted(map(str, [(int, bytes), (bytes, int)]))

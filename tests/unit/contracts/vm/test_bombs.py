"""What a hostile contract was once able to make the machine do: each of these took seconds or gigabytes."""

from __future__ import annotations

import time

import pytest

from consensus.primitives.encoding import encode_value
from contracts.vm import ContractSourceError, compile_contract
from contracts.vm.model.values import DICT_KEY_MAX_CHARS


def test_a_result_counts_as_often_as_its_parts_and_memory_that_runs_out_is_no_fault_of_the_arguments(run, bench):
    assert run("return [bytes(100000)] * 10 ** 5").code in ("OUT_OF_GAS", "MEMORY_BUDGET")
    assert run("return ['a' * 1000] * 20").ok
    bench.deploy("other", "@export\ndef f(x: list):\n    pass\n")
    bench.gas_limit = 10**7
    assert run("call('other', 'f', [bytes(100000)] * 10 ** 3)").code == "MEMORY_BUDGET"


@pytest.mark.parametrize("letter", ["'a'", "b'a'"])
def test_a_replacement_takes_the_memory_of_what_comes_of_it(run, letter):
    assert run(f"return len(({letter} * 1000).replace({letter}, {letter} * 1000))").result == 1_000_000
    assert run(f"return len(({letter} * 3000).replace({letter}, {letter} * 3000))").code == "MEMORY_BUDGET"


def test_what_scans_find_takes_memory(run, bench):
    """As long as nobody keeps it, too: what a call made is counted, not what is left."""
    bench.gas_limit = 10**9
    bench.host.entries.update({b"it\x00%0120d" % number: encode_value(None) for number in range(256)})
    assert run("for i in range(100):\n    state.scan(b'', 256)").ok
    assert run("for i in range(1000):\n    state.scan(b'', 256)").code == "MEMORY_BUDGET"


@pytest.mark.parametrize(
    "body",
    [
        "x = {}\nx[a] = 1", "return {a: 1}", "return a in {}", "return {}.get(a)", "return {}.pop(a, 1)",
        "x = {}\nx.setdefault(a, 1)", "return {i: 1 for i in [a]}", "return dict([(a, 1)])",
    ],
)  # fmt: skip
@pytest.mark.parametrize("letter", ["a", b"a"])
def test_no_key_takes_long_to_compare(run, body, letter):
    assert run(body, letter * (DICT_KEY_MAX_CHARS + 1)).code == "VALUE_ERROR"
    assert run(body, letter * DICT_KEY_MAX_CHARS).code in ("OK", "KEY_ERROR")


def test_a_key_that_stands_in_the_source_is_no_longer_either(run):
    assert run(f"return {{'{'a' * DICT_KEY_MAX_CHARS}': 1}}").ok
    assert run(f"return {{'{'a' * DICT_KEY_MAX_CHARS}a': 1}}").code == "VALUE_ERROR"


@pytest.mark.parametrize("pair", ["(X{0}, X{0})", "[X{0}, X{0}]", "{{'a': X{0}, 'b': X{0}}}"])
def test_constants_made_of_constants_do_not_double_for_ever(pair):
    constants = "X0 = (1, 2)\n" + "".join(f"X{n} = {pair.format(n - 1)}\n" for n in range(1, 60))
    with pytest.raises(ContractSourceError) as caught:
        compile_contract(f"{constants}\n@export\ndef f():\n    return X59\n", "it")
    assert {one.code for one in caught.value.diagnostics} == {"CONSTANT"}


def test_constants_hold_what_a_contract_needs_and_are_not_read_anew_for_every_use():
    source = "X = 'a' * 20000\nY = (1,) * 2000\n\n\n@export\ndef f():\n" + "    x = X\n    y = Y\n" * 2500
    started = time.thread_time()
    compile_contract(source, "it")
    assert time.thread_time() - started < 2, "read anew, the constants would be a hundred megabytes"
    with pytest.raises(ContractSourceError):
        compile_contract("X = 'a' * 200000\n\n\n@export\ndef f():\n    pass\n", "it")

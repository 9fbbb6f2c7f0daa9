"""What a call makes is charged first, whatever it is: f-strings, copies, conversions, frames, encodings."""

from __future__ import annotations

import gc
import random
import time
import tracemalloc

import pytest

from contracts.vm.builtins.builtins_table import BUILTINS, join_texts
from contracts.vm.builtins.operations import add, close_holes
from contracts.vm.model.faults import Fault
from contracts.vm.model.meter import CallContext, Runtime

LARGE = 4_000_000


@pytest.fixture
def runtime() -> Runtime:
    return Runtime(None, CallContext(b"", 0, 0, b"", b""), 10**9, lambda *_: None, None, False)  # type: ignore[arg-type]


def peak_of(make, *arguments) -> int:
    """Return the most that a function had taken, of which the budget of a call is refused."""
    tracemalloc.start()
    try:
        with pytest.raises(Fault):
            make(*arguments)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_an_f_string_is_charged_before_it_is_joined(runtime):
    assert peak_of(join_texts, runtime, ["a" * LARGE] * 300) < 100_000


def test_a_text_takes_the_width_of_its_widest_letter(runtime):
    before = runtime.memory
    add(runtime, "a" * 1000, "\U0001f600")
    assert before - runtime.memory > 4000
    before = runtime.memory
    join_texts(runtime, ["a" * 1000, "\U0001f600"])
    assert before - runtime.memory > 4000


@pytest.mark.parametrize("step", ["y = x.copy()", "y = z.keys()", "y = z.values()"])
def test_a_copy_is_charged_before_it_is_made(run, bench, step):
    bench.gas_limit = 10**8
    setup = "x = [1] * 170000\nz = {}\nz.update(dict(zip(range(20000), range(20000))))\n"
    assert run(setup + "for i in range(200):\n    " + step).code == "MEMORY_BUDGET"


def test_hexadecimal_digits_take_no_memory_by_the_pair(runtime):
    text = "00" * (LARGE // 2)
    tracemalloc.start()
    BUILTINS["bytes.fromhex"].run(runtime, text)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2 * LARGE


def test_wide_frames_use_up_the_depth(run, bench):
    """A function with many variables takes their room each time it is called: fewer calls stand on each other."""
    bench.gas_limit = 10**8
    names = "\n".join(f"    v{n} = n + {n + 1000}" for n in range(1500))
    depth = "    if n == {0}:\n        return 0\n"
    narrow = f"def down(n):\n{depth}    return down(n + 1)\n"
    wide = f"def down(n):\n{depth}{names}\n    return down(n + 1)\n"
    assert run("return down(0)", before=narrow.format(40)).ok
    assert run("return down(0)", before=wide.format(40)).code == "CALL_DEPTH"
    assert (
        run("return down(0)", before=wide.format(5)).gas_used
        > run("return down(0)", before=narrow.format(5)).gas_used + 400
    )


def test_shared_empty_dicts_are_counted_where_they_are_encoded(run, bench):
    bench.gas_limit = 2_000_000
    outcome = run("x = [{}] * 100000\nstate.put(b'k', x)")
    assert (outcome.code, outcome.gas_used < 400_000) == ("VALUE_ERROR", True)


def test_a_dict_of_deleted_entries_is_made_anew():
    entries = {n: n for n in range(10_000)}
    for n in range(9_990):
        del entries[n]
    order, before = list(entries.items()), entries.__sizeof__()
    close_holes(entries)
    assert list(entries.items()) == order
    assert entries.__sizeof__() < before // 50


def test_ints_that_are_found_slowly_are_paid_for(bench, run):
    """Keys chosen so that a search passes hundreds of others are found at a price by the size of the dict."""
    bench.gas_limit = 10**7
    bits, count = 12, 2000
    mask, slots, slot = (1 << bits) - 1, [], 1
    for _ in range(count):
        slots.append(slot)
        slot = (5 * slot + 1) & mask
    places = {slot: place for place, slot in enumerate(slots)}
    chance = random.Random(1)
    drawn = (chance.randrange(1 << 59) for _ in range(10**6))
    wanted = next(key for key in drawn if _enters(key, mask, places) < count // 5)
    keys = f"x = {{}}\ni = 1\nfor n in range({count}):\n    x[i] = 0\n    i = (5 * i + 1) & {mask}\n"
    loop = "for n in range(20000):\n    y = {0} in x\n"
    spent: list[float] = []
    for key in (1, wanted):
        without, started = run(keys).gas_used, time.thread_time()
        outcome = run(keys + loop.format(key))
        spent.append((time.thread_time() - started) / (outcome.gas_used - without))
    assert spent[1] < 20 * spent[0]
    assert outcome.gas_used - without > 20000 * (count >> 6)


def _enters(key: int, mask: int, places: dict[int, int]) -> int:
    """Return where in the row of held slots a search for the key ends up, after which it passes all of the row."""
    slot, rest = key & mask, key
    while slot in places:
        rest >>= 5
        slot = (5 * slot + rest + 1) & mask
        if not rest:
            return places.get(slot, len(places))
    return len(places)


def test_choices_of_types_are_paid_for(bench):
    """A type of many alternatives is looked at for each item: that is charged by the item and alternative."""
    kinds = " | ".join(["str"] * 20 + ["int"])
    source = "@export\ndef f(x: list[{0}]):\n    pass\n"
    bench.deploy("one", source.format("int"))
    bench.deploy("many", source.format(kinds))
    caller = "@export\ndef f(name: str):\n    call(name, 'f', [1] * 1000)\n"
    bench.deploy("it", caller)
    assert bench.call("it.f", "many").gas_used >= bench.call("it.f", "one").gas_used + 20_000


def test_lists_that_hold_themselves_do_not_pile_up(bench):
    """Each call leaves seven megabytes that only a search for cycles finds; the interpreter's own may come too late."""
    bench.deploy("it", "@export\ndef f():\n    x = [bytes(7000000)]\n    x.append(x)\n")
    gc.disable()
    tracemalloc.start()
    try:
        assert all(bench.call("it.f").ok for _ in range(40))
        assert tracemalloc.get_traced_memory()[1] < 12 * 8_000_000
    finally:
        tracemalloc.stop()
        gc.enable()

"""What runs costs, and what costs too much stops; the same whichever way it is cut."""

from __future__ import annotations

import sys

import pytest

from contracts.vm.model.meter import DEPTH_MAX_FRAMES, MEMORY_MAX_BYTES


def test_gas_counts_the_steps_and_the_price_of_known_calls_does_not_change_unnoticed(run):
    one, ten = run("for i in range(1):\n    pass").gas_used, run("for i in range(10):\n    pass").gas_used
    hundred = run("for i in range(100):\n    pass").gas_used
    assert (hundred - ten) == 10 * (ten - one) > 0
    # These numbers are part of the protocol: a change here forks the chain.
    assert run("return 1").gas_used == 43
    assert run("return [i * 2 for i in range(10)]").gas_used == 146
    assert run("state.put(b'key', {'a': 1})").gas_used == 180
    assert run("return sha256(b'abc')").gas_used == 62


def test_a_loop_without_end_costs_all_it_was_given_and_more_gas_than_needed_changes_nothing(run, bench):
    outcome = run("while True:\n    pass")
    assert (outcome.code, outcome.gas_used) == ("OUT_OF_GAS", 250_000)
    assert outcome.line in (4, 5)
    body = "x = []\nfor i in range(20):\n    x.append({'i': i})\nreturn x"
    needed = run(body).gas_used
    bench.gas_limit = needed
    assert run(body).gas_used == needed
    bench.gas_limit = needed - 1
    assert run(body).code == "OUT_OF_GAS"


@pytest.mark.parametrize(
    "body",
    [
        "x = 'a' * 10 ** 9",
        "x = b'a' * 10 ** 60",
        "x = [0] * 2 ** 100",
        "x = list(range(2 ** 59))",
        "x = sum(range(2 ** 59))",
        "x = bytes(2 ** 200)",
        "x = [i for i in range(2 ** 59)]",
        "x = sorted(range(2 ** 59))",
        "x = (1, 2) * 10 ** 30",
        "x = 'ä' * 10 ** 7",
        "x = 'a' * 10 ** 5\ny = x.replace('a', 'b' * 10 ** 4)",
        "x = ('a' * 10 ** 4).join(['b'] * 10 ** 4)",
        "x = 'a'\nwhile True:\n    x = x + x",
        "x = [1]\nwhile True:\n    x.extend(x)",
        "x = ['a' * 1000]\nwhile True:\n    x = x + x",
    ],
)
def test_memory_is_refused_before_it_is_taken(run, bench, body):
    bench.gas_limit = 10_000_000
    assert run(body).code in ("MEMORY_BUDGET", "OUT_OF_GAS")


def test_a_host_call_costs_by_what_it_moves_and_memory_runs_out_even_where_gas_does_not(run, bench):
    small = run("state.put(b'k', bytes(10))").gas_used
    large = run("state.put(b'k', bytes(1010))").gas_used
    assert large - small >= 1000 // 8
    bench.gas_limit = 10**9
    assert run(f"return len(bytes({MEMORY_MAX_BYTES}))").code == "MEMORY_BUDGET"
    assert run(f"return len(bytes({MEMORY_MAX_BYTES // 2}))").ok


def test_recursion_ends_with_a_code_and_within_the_budget_gives_the_depth_back(run):
    before = "def down(n):\n    return down(n + 1) + 1\n"
    assert run("return down(0)", before=before).code == "CALL_DEPTH"
    before = "def down(n):\n    if n == 0:\n        return 0\n    return down(n - 1) + 1\n"
    assert run("return [down(30) for i in range(20)]", before=before).result == [30] * 20


def test_the_deepest_call_leaves_room_in_the_interpreters_own_stack(run, bench):
    """Every shape of nesting, as deep as the budget lets it go, ends by the budget and not by Python's limit."""
    assert sys.getrecursionlimit() > 2 * DEPTH_MAX_FRAMES
    shapes = [
        "return [g(n)]", "return {'a': [g(n)]}", "return [g(i) for i in [n]]", "return f'{g(n)}'",
        "return 1 + (1 + (1 + (1 + g(n))))", "return g(n) if n or g(n) else 0", "return max(1, g(n), 2)",
        "for i in [1]:\n        while True:\n            if n:\n                return g(n)",
        "if not n:\n        return 1\n    elif n:\n        return g(n)", "return {i: g(i) for i in [n]}",
        "return 'a'.startswith(g(n))", "require(g(n), 'NO_WAY')", "return 0 < g(n) < 5", "x = [0]\n    x[g(n)] += 1",
    ]  # fmt: skip
    for shape in shapes:
        assert run("return g(1)", before=f"def g(n):\n    {shape}\n").code == "CALL_DEPTH", shape


def test_comparing_deep_or_shared_values_is_paid_for_and_ends(run):
    body = "x = [1]\ny = [1]\nfor i in range(40):\n    x = [x]\n    y = [y]\nreturn x == y"
    assert run(body).code == "VALUE_ERROR"
    body = "x = [1]\ny = [1]\nfor i in range(28):\n    x = [x, x]\n    y = [y, y]\nreturn x == y"
    assert run(body).code == "OUT_OF_GAS"
    assert run("d = {}\nd[2 ** 61 - 1] = 1").code == "VALUE_ERROR"


def test_what_is_made_costs_the_same_whichever_way_it_is_written(run):
    """The short cuts that the compiler takes for common shapes ask the price that the plain way asks."""
    assert (
        run("y = b'c' * 900\nreturn b'ab' + y").gas_used + 2 == run("x = b'ab'\ny = b'c' * 900\nreturn x + y").gas_used
    )
    assert run("y = 5\nreturn 3 - y").gas_used == run("y = 5\nreturn y - 3").gas_used
    assert run("return len(b'abc') == 3").gas_used == run("return 3 == len(b'abc')").gas_used

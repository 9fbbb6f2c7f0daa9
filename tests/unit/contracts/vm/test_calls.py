"""Entries and calls between contracts: who may call what, with which arguments, as whom."""

from __future__ import annotations

import pytest

LEDGER = """
@export
def add(amount: int) -> int:
    total = state.get(b"total", 0) + amount
    state.put(b"total", total)
    emit("added", {"amount": amount, "for": ctx.calling_contract, "by": ctx.caller, "in": ctx.contract})
    return total

@view
def total() -> int:
    return state.get(b"total", 0)

@export
def fail(code: str):
    state.put(b"half", True)
    require(False, code)

@export
def back(name: str):
    call(name, "through", 1)

@genesis
def begin(amount: int = 5):
    state.put(b"total", amount)
"""

SHOP = """
@export
def through(amount: int) -> list:
    state.put(b"mine", amount)
    result = call("ledger", "add", amount)
    return [result, call("ledger", "total"), ctx.contract, ctx.calling_contract, state.get(b"mine")]

@export
def breaks(code: str):
    call("ledger", "fail", code)

@export
def round_trip():
    call("ledger", "back", "shop")

@export
def itself():
    call("shop", "through", 1)

@export
def nowhere(contract: str, entry: str):
    call(contract, entry, 1)

@view
def peek() -> int:
    return call("ledger", "total")

@view
def sly() -> int:
    return call("ledger", "add", 1)

@export
def shared(items: list) -> list:
    call("keeper", "change", items)
    return items
"""


@pytest.fixture
def market(bench):
    bench.deploy("ledger", LEDGER)
    bench.deploy("shop", SHOP)
    bench.deploy("keeper", "@export\ndef change(items: list):\n    items.append(1)\n")
    return bench


def test_a_call_names_the_calling_contract_and_a_failing_callee_fails_the_whole_call(market):
    outcome = market.call("shop.through", 5)
    assert outcome.result == [5, 5, "shop", "", 5]
    assert [(contract, name) for contract, name, _ in outcome.events] == [("ledger", "added")]
    assert b"shop" in outcome.events[0][2]
    assert sorted(market.host.entries) == [b"ledger\x00total", b"shop\x00mine"]
    outcome = market.call("shop.breaks", "BROKEN_THERE")
    assert (outcome.code, outcome.line) == ("BROKEN_THERE", 16)
    assert outcome.message.startswith("In contract ledger: ")


def test_a_contract_already_running_is_not_entered_again(market):
    assert market.call("shop.round_trip").code == "REENTRANT"
    assert market.call("shop.itself").code == "REENTRANT"


@pytest.mark.parametrize(("count", "code"), [(30, "OK"), (51, "CALL_DEPTH")])
def test_contracts_call_each_other_as_deep_as_functions_may(market, count, code):
    """A call between contracts takes the place of 40 frames of the 2,000 that there are."""
    market.deploy("c0", "@export\ndef f():\n    pass\n")
    for number in range(1, count):
        market.deploy(f"c{number}", f"@export\ndef f():\n    call('c{number - 1}', 'f')\n")
    market.deploy("front", f"@export\ndef f():\n    call('c{count - 1}', 'f')\n")
    assert market.call("front.f").code == code


def test_gas_is_shared_with_the_callee(market):
    assert market.call("shop.through", 5).gas_used > market.call("ledger.add", 5).gas_used + 50
    market.gas_limit = 200
    outcome = market.call("shop.through", 5)
    assert (outcome.code, outcome.gas_used) == ("OUT_OF_GAS", 200)


@pytest.mark.parametrize(("contract", "entry"), [("nobody", "f"), ("ledger", "nothing"), ("ledger", "begin"), ("", "")])
def test_only_exports_and_views_that_exist_can_be_called(market, contract, entry):
    assert market.call("shop.nowhere", contract, entry).code == "ENTRY_UNKNOWN"


def test_a_view_reads_through_calls_and_writes_not_even_through_them_or_below_an_export(market):
    market.call("ledger.add", 3)
    assert market.call("shop.peek", mode="view").result == 3
    assert market.call("shop.sly", mode="view").code == "VIEW_WRITES"
    market.deploy("front", "@export\ndef f():\n    call('shop', 'sly')\n")
    assert market.call("front.f").code == "VIEW_WRITES"


@pytest.mark.parametrize("change", ["state.put(b'k', 1)", "state.delete(b'k')", "emit('x', {})"])
def test_nothing_that_changes_something_is_allowed_below_a_view(market, change):
    market.deploy("back", f"@export\ndef f():\n    {change}\n")
    market.deploy("front", "@view\ndef f():\n    return call('back', 'f')\n")
    market.deploy("top", "@export\ndef f():\n    call('front', 'f')\n")
    assert market.call("back.f").ok
    assert market.call("front.f", mode="view").code == "VIEW_WRITES"
    assert market.call("top.f").code == "VIEW_WRITES"


def test_an_export_may_write_again_after_it_called_a_view(market):
    market.deploy("front", "@export\ndef f():\n    call('shop', 'peek')\n    state.put(b'k', 1)\n")
    assert market.call("front.f").ok


def test_neither_contracts_nor_the_node_share_lists(market, bench):
    assert market.call("shop.shared", [0]).result == [0]
    bench.deploy("it", "@export\ndef f(items: list) -> int:\n    items.append(1)\n    return len(items)\n")
    given = [[]]
    assert bench.call("it.f", given[0]).result == 1
    assert given == [[]]


@pytest.mark.parametrize(
    ("mode", "entry"),
    [("export", "total"), ("export", "begin"), ("view", "add"), ("genesis", "add"), ("export", "_no")],
)
def test_an_entry_is_called_in_its_own_way_only(market, mode, entry):
    assert market.call(f"ledger.{entry}", 1, mode=mode).code == "ENTRY_UNKNOWN"


def test_genesis_entries_run_while_the_genesis_block_is_made_and_helpers_are_no_entries(market, bench):
    assert market.call("ledger.begin", mode="genesis").ok
    assert market.call("ledger.total", mode="view").result == 5
    bench.deploy("it", "def helper():\n    return 1\n\n@export\ndef f():\n    return helper()\n")
    assert bench.call("it.helper").code == "ENTRY_UNKNOWN"


TYPES = """
@export
def f(a: int, b: str | None, c: list[bytes], d: dict[str, list[int]], e: bool = True, g: object = None) -> list:
    return [a, b, c, d, e, g]
"""


def test_the_abi_tells_names_types_and_what_may_be_left_out(bench):
    entry = bench.deploy("it", TYPES).abi.entry("f")
    assert entry is not None
    assert entry.params == (
        ("a", "int"), ("b", "str | None"), ("c", "list[bytes]"), ("d", "dict[str, list[int]]"), ("e", "bool"),
        ("g", "object"),
    )  # fmt: skip
    assert (entry.kind, entry.returns, entry.required) == ("export", "list", 4)
    assert bench.contracts["it"].abi.entry("g") is None


def test_arguments_that_fit_come_through_and_a_result_that_breaks_its_promise_fails(bench):
    bench.deploy("it", TYPES)
    assert bench.call("it.f", 1, None, [b"x"], {"k": [1]}).result == [1, None, [b"x"], {"k": [1]}, True, None]
    assert bench.call("it.f", 1, "s", [], {}, False, {"any": 1}).result == [1, "s", [], {}, False, {"any": 1}]
    bench.deploy("it", "@view\ndef f() -> int:\n    return 'text'\n")
    assert bench.call("it.f", mode="view").code == "TYPE_ERROR"


@pytest.mark.parametrize(
    "arguments",
    [
        (), (1, None, []), (1, None, [], {}, True, 1, 2), (True, None, [], {}), ("1", None, [], {}),
        (1, b"", [], {}), (1, None, ["text"], {}), (1, None, [], {b"k": []}), (1, None, [], {"k": ["1"]}),
        (1, None, [], {}, 1), (1, None, [], {}, True, 1.5), (2**256, None, [], {}), (1, "\ud800", [], {}),
        (1, None, [], {}, True, {1.5: 1}), (1, None, [], {}, True, {1, 2}),
    ],
)  # fmt: skip
def test_arguments_that_do_not_fit_are_refused_before_the_call(bench, arguments):
    bench.deploy("it", TYPES)
    outcome = bench.call("it.f", *arguments)
    assert outcome.code == "ARGUMENTS_INVALID"
    assert outcome.gas_used < 300

"""The same source and arguments give the same result and the same charge; and where Python agrees, Python's result."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
from typing import Any

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from contracts.vm import CallContext, ContractSourceError, Outcome, compile_contract, invoke

LIMIT = 1 << 256
NAMES = ("a", "b", "c", "d")
CONTEXT = CallContext(caller=b"c" * 33, height=1, time_ms=2, txid=b"t" * 32, chain_id=b"i" * 32)


class EmptyHost:
    def get(self, key: bytes) -> bytes | None:
        return None

    def put(self, key: bytes, value: bytes) -> None:
        return None

    def delete(self, key: bytes) -> None:
        return None

    def scan(self, prefix: bytes, limit: int) -> list[tuple[bytes, bytes]]:
        return []

    def emit(self, name: str, data: bytes) -> None:
        return None


def run(source: str, arguments: list[Any]) -> Outcome:
    contracts = {"it": compile_contract(source, "it")}
    return invoke(contracts, "it", "f", arguments, host=EmptyHost(), context=CONTEXT, gas_limit=100_000, mode="export")


def entry(expression: str) -> str:
    params = ", ".join(f"{name}: object" for name in NAMES)
    return f"@export\ndef f({params}):\n    return {expression}\n"


leaves = st.one_of(
    st.sampled_from(NAMES),
    st.integers(0, 1 << 70).map(str),
    st.sampled_from(["True", "False", "None", "''", "'abc'", "b'ab'", "b''", "[]", "{}", "'é'"]),
)
binary_signs = st.sampled_from(["+", "-", "*", "//", "%", "**", "<<", ">>", "&", "|", "^"])
comparisons = st.sampled_from(["==", "!=", "<", "<=", ">", ">=", "in", "not in"])
calls = st.sampled_from(["len", "abs", "sorted", "list", "bool", "reversed", "str", "min", "sum", "any", "all"])
methods = st.sampled_from(
    [".upper()", ".strip()", ".hex()", ".split('b')", ".keys()", ".pop()", ".bit_length()", ".find('b')", "[0]", "[-1]",
     "[1:]", "[:-1]", "[a]"]
)  # fmt: skip


def extend(inner: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    return st.one_of(
        st.builds(lambda x, s, y: f"({x} {s} {y})", inner, binary_signs, inner),
        st.builds(lambda x, s, y: f"({x} {s} {y})", inner, comparisons, inner),
        st.builds(lambda x, y, z: f"({x} if {y} else {z})", inner, inner, inner),
        st.builds(lambda x, s, y: f"({x} {s} {y})", inner, st.sampled_from(["and", "or"]), inner),
        st.builds(lambda s, x: f"({s}{x})", st.sampled_from(["-", "~", "+", "not "]), inner),
        st.builds(lambda f, x: f"{f}({x})", calls, inner),
        st.builds(lambda x, m: f"({x}){m}", inner, methods),
        st.lists(inner, max_size=3).map(lambda xs: f"[{', '.join(xs)}]"),
        st.builds(lambda x, y: f"[{x} for d in {y}]", inner, inner),
        st.builds(lambda x, y: f"{{'k': {x}, 'l': {y}}}", inner, inner),
    )


expressions = st.recursive(leaves, extend, max_leaves=10)
numbers = st.recursive(
    st.one_of(st.sampled_from(NAMES), st.integers(0, 1 << 90).map(str)),
    lambda inner: st.one_of(
        st.builds(
            lambda x, s, y: f"({x} {s} {y})",
            inner,
            st.sampled_from(["+", "-", "*", "//", "%", "&", "|", "^", ">>", "<<", "**"]),
            inner,
        ),
        st.builds(lambda s, x: f"({s}{x})", st.sampled_from(["-", "~"]), inner),
        st.builds(lambda x, y, z: f"({x} if {y} < {z} else {y})", inner, inner, inner),
    ),
    max_leaves=12,
)
values = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(-(1 << 255), 1 << 255), st.text(max_size=5), st.binary(max_size=5)),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(st.text(max_size=3), inner, max_size=3)),
    max_leaves=6,
)
relaxed = settings(suppress_health_check=[HealthCheck.too_slow])


def attempt(source: str, arguments: list[Any]) -> Outcome | None:
    try:
        return run(source, arguments)
    except ContractSourceError:
        return None


@relaxed
@given(expressions, st.lists(values, min_size=4, max_size=4))
def test_a_program_gives_the_same_result_and_charge_twice(expression, arguments):
    first, second = attempt(entry(expression), arguments), attempt(entry(expression), arguments)
    assert first == second
    if first is not None and first.ok:
        assert 0 < first.gas_used <= 100_000


@relaxed
@given(expressions, st.lists(values, min_size=4, max_size=4))
def test_gas_does_not_depend_on_how_much_is_left(expression, arguments):
    outcome = attempt(entry(expression), arguments)
    if outcome is None or not outcome.ok:
        return
    contracts = {"it": compile_contract(entry(expression), "it")}
    tight = invoke(
        contracts, "it", "f", arguments,
        host=EmptyHost(), context=CONTEXT, gas_limit=outcome.gas_used, mode="export",
    )  # fmt: skip
    assert tight == outcome


class TooLargeError(Exception):
    pass


def python_value(node: ast.expr, names: dict[str, int]) -> int:
    """Evaluate an expression of whole numbers as CPython does, failing where a step leaves 256 bits."""
    if isinstance(node, ast.Constant):
        result = node.value
    elif isinstance(node, ast.Name):
        result = names[node.id]
    elif isinstance(node, ast.UnaryOp):
        operand = python_value(node.operand, names)
        result = -operand if isinstance(node.op, ast.USub) else ~operand
    elif isinstance(node, ast.IfExp):
        test = node.test
        assert isinstance(test, ast.Compare)
        smaller = python_value(test.left, names) < python_value(test.comparators[0], names)
        result = python_value(node.body if smaller else node.orelse, names)
    else:
        assert isinstance(node, ast.BinOp)
        left, right = python_value(node.left, names), python_value(node.right, names)
        large = isinstance(node.op, ast.Pow | ast.LShift)
        if large and right > 256 and not (left in (0, 1, -1) and isinstance(node.op, ast.Pow)) and left != 0:
            raise TooLargeError
        if large and left in (0, 1, -1):
            right = right if right <= 0 else 256 + right % 2 if right > 256 else right
        if isinstance(node.op, ast.RShift):
            right = min(right, 1000)
        if large and right < 0:
            raise ValueError
        result = apply(node.op, left, right)
    if not -LIMIT < result < LIMIT:
        raise TooLargeError
    return int(result)


def apply(op: ast.operator, left: int, right: int) -> int:
    table = {
        ast.Add: int.__add__, ast.Sub: int.__sub__, ast.Mult: int.__mul__, ast.FloorDiv: int.__floordiv__,
        ast.Mod: int.__mod__, ast.BitAnd: int.__and__, ast.BitOr: int.__or__, ast.BitXor: int.__xor__,
        ast.RShift: int.__rshift__, ast.LShift: int.__lshift__, ast.Pow: int.__pow__,
    }  # fmt: skip
    return table[type(op)](left, right)


@relaxed
@given(numbers, st.lists(st.integers(-(1 << 128), 1 << 128), min_size=4, max_size=4))
def test_whole_numbers_are_pythons_up_to_256_bits(expression, arguments):
    outcome = attempt(entry(expression), arguments)
    if outcome is None:
        return
    try:
        expected = python_value(ast.parse(expression, mode="eval").body, dict(zip(NAMES, arguments, strict=True)))
    except ZeroDivisionError:
        assert outcome.code == "ZERO_DIVISION"
    except ValueError:
        assert outcome.code == "VALUE_ERROR"
    except TooLargeError:
        assert outcome.code == "INT_OVERFLOW"
    else:
        assert (outcome.code, outcome.result) == ("OK", expected)


@relaxed
@given(st.text(alphabet="abcdef()[]{}:=+-*/%.,'\"\\#\n 01xf@;<>!&|^~\t\ud800é", max_size=120))
def test_any_text_is_compiled_or_refused_and_nothing_else_happens(text):
    source = "@export\ndef f():\n    return 1\n" + text
    try:
        compiled = compile_contract(source, "it")
    except ContractSourceError as refusal:
        lines = source.count("\n") + 2
        found = [1 <= problem.line <= lines for problem in refusal.diagnostics]
    else:
        found = [compiled.abi.entry("f") is not None]
    assert found
    assert all(found)


CORPUS = [
    ("[k for k in {'x': 1, 'a': 2, b'b': 3, 4: 5}]", [1, 2, 3, 4]),
    ("sorted([a, b, c]) + [str(d)]", ["x", "é", "", 2**200]),
    ("{'k': [a, b], 'l': c}", [b"x", None, True, 0]),
    ("tagged_hash('t', a) + sha256(b)", [b"1", b"2", 3, 4]),
    ("f'{a} {b} {c}' * 30", [1, None, "z", 0]),
    ("[x * x for x in range(100) if x % 3 == a]", [1, 0, 0, 0]),
]


def digest_of_corpus() -> str:
    return "|".join(f"{run(entry(text), arguments)}" for text, arguments in CORPUS)


def test_a_corpus_gives_the_same_under_other_hash_seeds():
    script = (
        "import importlib.util, sys;"
        f"spec = importlib.util.spec_from_file_location('determinism', {__file__!r});"
        "module = importlib.util.module_from_spec(spec); sys.modules['determinism'] = module;"
        "spec.loader.exec_module(module); print(ascii(module.digest_of_corpus()))"
    )
    for seed in ("0", "77"):
        environment = {**os.environ, "PYTHONHASHSEED": seed}
        done = subprocess.run(
            [sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True
        )
        assert done.stdout.strip() == ascii(digest_of_corpus())

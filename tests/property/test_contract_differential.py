"""What the language accepts runs the same under plain CPython: random programs, both ways, one outcome."""

from __future__ import annotations

import ast
import re
from collections import Counter
from dataclasses import replace
from random import Random

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from contracts.vm.builtins.host import CONTEXT_FIELDS
from contracts.vm.builtins.methods import METHODS
from contracts.vm.frontend.name_binding import CALLABLES, dotted_name
from tests.effort import EFFORT
from tests.property.both_ways import arguments_of, compare, digest_of_programs, run
from tests.property.contract_phrases import SIGNS
from tests.property.contract_programs import ProgramWriter

CONSTRUCTS = set(
    re.findall(
        r"\w+",
        """
        Assign AnnAssign AugAssign Expr Return If For While Break Continue Delete Pass FunctionDef Constant Name BinOp
        UnaryOp BoolOp Compare IfExp Call Attribute Subscript Slice List Tuple Dict ListComp DictComp GeneratorExp
        JoinedStr FormattedValue Add Sub Mult FloorDiv Mod Pow LShift RShift BitAnd BitOr BitXor USub UAdd Invert Not
        And Or Eq NotEq Lt LtE Gt GtE In NotIn Is IsNot
        """,
    )
)
FOR_LIFECYCLE = {"charge_source", "check_source"}
ENOUGH_COUNT = 5


def check_programs(examples: int) -> None:
    seen: dict[str, int] = {}

    @settings(max_examples=examples, suppress_health_check=list(HealthCheck), database=None)
    @given(st.randoms(use_true_random=False))
    def every_program_ends_the_same(random: Random) -> None:
        source = ProgramWriter(random).program()
        code = compare(source, arguments_of(random))
        seen[code] = seen.get(code, 0) + 1

    every_program_ends_the_same()
    assert seen.get("OK", 0) > sum(seen.values()) / 20, seen
    assert len(seen) >= 5, seen


def test_programs_end_the_same_under_plain_python():
    check_programs(150)


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_many_programs_end_the_same_under_plain_python():
    check_programs(500 * EFFORT)
    assert len(digest_of_programs(2_000 * EFFORT)) == 64


def sources(count: int) -> list[str]:
    return [ProgramWriter(Random(number)).program() for number in range(count)]


def test_random_programs_have_every_construct_function_and_field():
    nodes = [node for source in sources(400) for node in ast.walk(ast.parse(source))]
    constructs = Counter(type(node).__name__ for node in nodes)
    functions = Counter(dotted_name(node.func) for node in nodes if isinstance(node, ast.Call))
    fields = Counter(
        node.attr for node in nodes if isinstance(node, ast.Attribute) and dotted_name(node.value) == "ctx"
    )
    added_to = Counter(type(node.op) for node in nodes if isinstance(node, ast.AugAssign))
    assert {name for name in CONSTRUCTS if constructs[name] < ENOUGH_COUNT} == set()
    assert {name for name in {*CALLABLES, "isinstance"} if functions[name] < ENOUGH_COUNT} == FOR_LIFECYCLE
    assert {name for name in CONTEXT_FIELDS if fields[name] < ENOUGH_COUNT} == set()
    assert len(added_to) == len(SIGNS)


def test_random_programs_call_every_method_of_every_type(monkeypatch):
    called: set[tuple[str, type]] = set()

    def noted(name, kind, method):
        def wrapped(runtime, *arguments):
            called.add((name, kind))
            return method(runtime, *arguments)

        return wrapped

    for name, table in METHODS.items():
        for kind, method in list(table.items()):
            monkeypatch.setitem(table, kind, replace(method, run=noted(name, kind, method.run)))
    wanted = {(name, kind) for name, table in METHODS.items() for kind in table}
    for number, source in enumerate(sources(1_500)):
        run(source, arguments_of(Random(number)))
        if called == wanted:
            break
    assert wanted - called == set()

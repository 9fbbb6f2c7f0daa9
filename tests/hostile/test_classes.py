"""Every kind of attack that is known of has its programs in the corpus; who takes the last of a kind out fails here.

The kinds are named by hand. That nothing of the language is left without an end by budget is asked of the machine: which
functions, methods, operators and constructs the programs use that run until a budget ends them.
"""

from __future__ import annotations

import ast
import re
from dataclasses import replace

import pytest

from contracts.vm.builtins.methods import METHODS
from contracts.vm.frontend.name_binding import CALLABLES, dotted_name
from network.lab.hostile.families import CORPUS, FAMILIES
from network.lab.hostile.program import REFUSED, Program
from network.lab.hostile.running import run_program

KINDS = {
    "endless loops": "loop-for-ever loop-over-a-growing-list loop-over-a-huge-range comprehension-for-ever",
    "recursion": "recursion recursion-of-two recursion-of-fifty recursion-as-a-tree recursion-by-default",
    "bombs by operators": "text-times bytes-times list-times tuple-times text-doubling power-tower shift-far",
    "bombs by methods": "text-joined text-replaced bytes-replaced list-extends-itself dict-updates text-split",
    "bombs by conversion": "list-of-range bytes-of-a-length bytes-to-hex many-bytes-of-a-number number-of-a-long-text",
    "bombs in constants": "constant-text-bomb constant-power-bomb constant-list-in-lists default-bomb",
    "deep values": "deep-stored deep-emitted deep-returned deep-passed deep-compared argument-very-deep",
    "deep sources": "brackets blocks-in-blocks elif-without-end sum-of-thousands types-in-types calls-of-calls",
    "format tricks": "format format-map percent-format f-string-width f-string-conversion f-string-nested-width",
    "attributes": "init-globals function-globals context-runtime host-of-state method-as-a-value getattr",
    "dunders": "class-of-a-value subclasses dunder-import dunder-builtins constant-named-dunder calls-a-dunder",
    "exceptions that eat the budget": "budget-caught budget-eaten-in-finally exception-caught raise failure-is-not-caught",
    "generators": "yield yield-from generator-frame",
    "decorators": "decorator-called decorator-of-ones-own decorator-attribute decorators-in-rows",
    "closures": "closure lambda nonlocal functions-in-functions lambda-in-lambda",
    "names in Unicode": "cyrillic-name name-that-normalises bold-name zero-width-space bidi-override wide-digits",
    "shadowing of builtins": "shadow-len shadow-require shadow-by-loop shadow-by-comprehension function-named-len",
    "shadowing of ctx and state": "shadow-ctx shadow-state parameter-named-ctx assign-to-ctx delete-state",
    "floods of events": "events large-events event-too-large",
    "floods of keys": "keys one-key-again-and-again deletes writes-and-deletes key-too-long",
    "floods of values": "large-values value-too-large value-too-large-in-parts value-too-shared",
    "floods of calls": "calls-without-end calls-of-nothing calls-with-large-arguments calls-deeper-and-deeper",
    "floods of reads": "reads scans scans-of-large-values reads-kept",
    "floods of cryptography": "hashes tagged-hashes signatures signatures-that-recover",
    "re-entrance": "re-entered re-entered-at-another-entry re-entered-through-three calls-itself calls-itself-by-a-view",
    "abuse of other contracts": "calls-a-helper calls-genesis migration-called-by-another arguments-are-copies "
    "results-are-copies keys-of-the-callee-are-its-own budgets-are-shared-gas result-of-a-wrong-type",
    "callbacks into views": "view-writes-through-another view-writes-through-a-view export-writes-through-a-view "
    "view-emits-through-another view-called-back-to-write view-called-back-to-look",
    "what only the machine calls": "keys-in-genesis-only migration-called source-charged source-compiled",
    "long sources": "sixty-thousand-lines sixty-thousand-empty-lines sixty-thousand-bytes-of-text "
    "statements-up-to-the-limit functions-up-to-the-limit problems-without-end",
}
BY_NAME = {program.name: program for program in CORPUS}
ENDLESS = [program for program in CORPUS if program.expect in ("OUT_OF_GAS|MEMORY_BUDGET", "MEMORY_BUDGET")]
OWN_ENDS = {"charge_source", "check_source"}
"""For the contract `lifecycle` alone, which no program of the corpus is."""
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


@pytest.mark.parametrize("kind", KINDS)
def test_a_kind_of_attack_has_its_programs(kind):
    names = KINDS[kind].split()
    assert len(names) >= 3
    assert set(names) - set(BY_NAME) == set()


def test_every_program_has_a_family():
    assert sum(len(programs) for programs in FAMILIES.values()) == len(CORPUS)


def functions_of(program: Program) -> set[str | None]:
    calls = [node for node in ast.walk(ast.parse(program.source)) if isinstance(node, ast.Call)]
    return {dotted_name(call.func) for call in calls}


def test_every_function_is_called_until_a_budget_ends_it():
    called = set().union(*(functions_of(program) for program in ENDLESS))
    assert set(CALLABLES) - called == OWN_ENDS


def test_every_construct_is_repeated_until_a_budget_ends_it():
    used = {type(node).__name__ for program in ENDLESS for node in ast.walk(ast.parse(program.source))}
    assert CONSTRUCTS - used == set()


def test_every_method_of_every_type_is_called_until_a_budget_ends_it(monkeypatch):
    called: set[tuple[str, type]] = set()

    def noted(name, kind, run):
        def wrapped(runtime, *arguments):
            called.add((name, kind))
            return run(runtime, *arguments)

        return wrapped

    for name, table in METHODS.items():
        for kind, method in list(table.items()):
            monkeypatch.setitem(table, kind, replace(method, run=noted(name, kind, method.run)))
    for program in ENDLESS:
        assert not run_program(program).came_to.startswith(REFUSED)
    assert {(name, kind) for name, table in METHODS.items() for kind in table} - called == set()

"""What the checker says of a source that is not in the language: every problem, where it is, and what to write instead."""

from __future__ import annotations

import pytest

from contracts.vm import ContractSourceError, compile_contract


def test_every_problem_of_a_source_is_told_in_order(problems):
    source = """
import os
RATE = 1.5

class Thing:
    pass

@export
def f(a, b: set):
    try:
        x = unknown + a
    except ValueError:
        pass
    return x.foo() / 2

@exports
def g(a: int):
    for x in [1]:
        yield x
    break
"""
    found = [(one.line, one.code) for one in problems(source)]
    assert found == [
        (2, "NOT_IN_LANGUAGE"),
        (3, "NUMBER"),
        (5, "NOT_IN_LANGUAGE"),
        (9, "ANNOTATION_MISSING"),
        (9, "ANNOTATION"),
        (10, "NOT_IN_LANGUAGE"),
        (11, "NAME_UNKNOWN"),
        (14, "FLOAT"),
        (14, "METHOD_UNKNOWN"),
        (16, "DECORATOR"),
        (19, "NOT_IN_LANGUAGE"),
        (20, "OUTSIDE_LOOP"),
    ]


def test_a_problem_has_a_place_a_sentence_and_a_fix_and_the_error_names_the_contract(problems):
    (problem,) = problems("@export\ndef f(a: int):\n    return a + nothing\n")
    assert (problem.line, problem.column, problem.code) == (3, 16, "NAME_UNKNOWN")
    assert problem.message == "There is no nothing."
    assert problem.fix.endswith(".")
    assert str(problem).startswith("3:16 NAME_UNKNOWN: ")
    with pytest.raises(ContractSourceError) as caught:
        compile_contract("x", "shop")
    assert caught.value.code == "CONTRACT_SOURCE_INVALID"
    assert "shop:1:1" in caught.value.detail


@pytest.mark.parametrize("name", ["", "Shop", "1shop", "a" * 33, "a\x00b", "a.b", "ä"])
def test_a_contracts_name_is_plain(name):
    with pytest.raises(ContractSourceError) as caught:
        compile_contract("@export\ndef f():\n    pass\n", name)
    assert caught.value.diagnostics[0].code == "CONTRACT_NAME"


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("len = 1", "NAME_RESERVED"),
        ("for state in [1]:\n        pass", "NAME_RESERVED"),
        ("x = [ctx for ctx in [1]]", "NAME_RESERVED"),
        ("x = f", "NOT_A_VALUE"),
        ("x = len", "NOT_A_VALUE"),
        ("x = state", "NOT_A_VALUE"),
        ("x = ctx.nobody", "CONTEXT"),
        ("x = ctx.caller()", "NOT_CALLABLE"),
        ("x = 1\n    x()", "NOT_CALLABLE"),
        ("f()()", "NOT_CALLABLE"),
        ("x = [].append", "ATTRIBUTE"),
        ("x = {}\n    x.y = 1", "ASSIGNMENT"),
        ("x = y = 1", "ASSIGNMENT"),
        ("x = [0]\n    x[0:1] = [1]", "ASSIGNMENT"),
        ("(x, (y, z)) = 1, (2, 3)", "ASSIGNMENT"),
        ("x: int", "ASSIGNMENT"),
        ("x = 1\n    del x", "DELETE"),
        ("1 + 1", "NO_EFFECT"),
        ("x = 1 is 1", "IDENTITY"),
        ("x = [1][::2]", "SLICE_STEP"),
        ("x = [a for b in [] for a in b]", "COMPREHENSION"),
        ("for x in []:\n        pass\n    else:\n        pass", "LOOP_ELSE"),
        ("state.put(b'k')", "ARGUMENTS"),
        ("state.get(b'k', 1, 2)", "ARGUMENTS"),
        ("state.get(b'k', fallback=1)", "ARGUMENTS"),
        ("state.drop(b'k')", "NAME_UNKNOWN"),
        ("f(1)", "ARGUMENTS"),
        ("state.get(default=1, key=b'k')", "ARGUMENTS"),
        ("len(value=[])", "ARGUMENTS"),
        ("dict(value={})", "ARGUMENTS"),
        ("'a'.split(separator='b')", "ARGUMENTS"),
        ("sorted([1], True)", "ARGUMENTS"),
        ("[1].sort(True)", "ARGUMENTS"),
        ("(1).to_bytes(1, 'big', True)", "ARGUMENTS"),
        ("int.from_bytes(b'', 'big', True)", "ARGUMENTS"),
        ("max()", "ARGUMENTS"),
        ("[].append()", "ARGUMENTS"),
        ("isinstance(1, (int, str))", "ARGUMENTS"),
        ("isinstance(1)", "ARGUMENTS"),
        ("require(True, 'lower_case')", "CODE"),
        ("require(True, 'OUT_OF_GAS')", "CODE"),
        ("require(True)", "ARGUMENTS"),
        ("x = 2 ** 3 @ 4", "NOT_IN_LANGUAGE"),
        ("x = 1j", "NUMBER"),
        ("x = 1e5", "NUMBER"),
        ("x = 0o17", "NUMBER"),
        ("x = " + "9" * 90, "NUMBER"),
        ("x = ...", "NOT_IN_LANGUAGE"),
        ("x = 'a' 1", "SYNTAX"),
        ("x = (1", "BRACKET_OPEN"),
        ("x = 1)", "BRACKET"),
        ("x = 'abc", "STRING_OPEN"),
        ("x = r'abc'", "STRING_PREFIX"),
        ("x = '\\N{BULLET}'", "ESCAPE"),
        ("x = '\\d'", "ESCAPE"),
        ("x = b'\\u1234'", "ESCAPE"),
        ("x = '\\ud800'", "SURROGATE"),
        ("x = f'{1:>5}'", "F_STRING"),
        ("x = f'{1!r}'", "F_STRING"),
        ("x = f'{{1}'", "F_STRING"),
        ("x = 1; y = 2", "SEMICOLON"),
        ("x = 1 + \\\n 2", "BACKSLASH"),
        ("\tx = 1", "TAB"),
        ("ä = 1", "NOT_ASCII"),
        ("x = 1 ? 2", "CHARACTER"),
        ("x = " + "(" * 17 + "1" + ")" * 17, "NESTED_TOO_DEEP"),
        ("x = " + "+".join(["1"] * 100), "NESTED_TOO_DEEP"),
        ("x = " + "-" * 5000 + "1", "STATEMENT_TOO_LONG"),
        ("x = 'a'" + ".a" * 5000, "STATEMENT_TOO_LONG"),
    ],
)
def test_a_body_is_refused_for(problems, body, expected):
    found = problems(f"@export\ndef f():\n    {body}\n")
    assert expected in [one.code for one in found], found
    assert all(one.line >= 1 and one.column >= 1 and one.fix for one in found)


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("", "NO_ENTRY"),
        ("def f():\n    pass\n", "NO_ENTRY"),
        ("X = 1\nX = 2\n", "NAME_TWICE"),
        ("def f():\n    pass\ndef f():\n    pass\n", "NAME_TWICE"),
        ("def len():\n    pass\n", "NAME_RESERVED"),
        ("def __init__():\n    pass\n", "NAME_RESERVED"),
        ("@export\ndef _f():\n    pass\n", "NAME_RESERVED"),
        ("@export\ndef f(state: int):\n    pass\n", "NAME_RESERVED"),
        ("@export\n@view\ndef f():\n    pass\n", "DECORATOR"),
        ("@export()\ndef f():\n    pass\n", "DECORATOR"),
        ("@export\ndef f(*a: int):\n    pass\n", "PARAMETERS"),
        ("@export\ndef f(a: int, /):\n    pass\n", "PARAMETERS"),
        ("@export\ndef f(a: float):\n    pass\n", "ANNOTATION"),
        ("@export\ndef f(a: dict[str]):\n    pass\n", "ANNOTATION"),
        ("@export\ndef f() -> 'int':\n    pass\n", "ANNOTATION"),
        ("X = len('a')\n", "CONSTANT"),
        ("X = Y\nY = 1\n", "NAME_UNKNOWN"),
        ("X = 1 // 0\n@export\ndef f():\n    pass\n", "CONSTANT"),
        ("X = 'a' * 10 ** 9\n@export\ndef f():\n    pass\n", "CONSTANT"),
        ("X = {[]: 1}\n@export\ndef f():\n    pass\n", "CONSTANT"),
        ("X, Y = 1, 2\n", "CONSTANT"),
        ("X: int\n", "CONSTANT"),
        ("X += 1\n", "NOT_IN_LANGUAGE"),
        ("async def f():\n    pass\n", "NOT_IN_LANGUAGE"),
        ("@export\ndef f():\n    def g():\n        pass\n", "NOT_IN_LANGUAGE"),
        ("# -*- coding: latin-1 -*-\n", "ENCODING_COMMENT"),
        ("X = 1\r\n", "LINE_END"),
        ("#" * 70_000, "SOURCE_TOO_LONG"),
        ("X = '" + "ä" * 35_000 + "'\n", "SOURCE_TOO_LONG"),
        ("def f():\n" + "".join(" " * i + "if 1:\n" for i in range(1, 14)), "NESTED_TOO_DEEP"),
        ("def f(x):\n  if x:\n    pass\n" + "  elif x:\n    pass\n" * 61, "ELIF_TOO_MANY"),
        ("  X = 1\n", "SYNTAX"),
        ("def f(:\n", "BRACKET_OPEN"),
        ("\x00", "CHARACTER"),
    ],
)
def test_a_source_is_refused_for(problems, source, expected):
    assert expected in [one.code for one in problems(source)]


@pytest.mark.parametrize("body", ["state.put(b'k', 1)", "emit('e', {})", "helper()"])
def test_a_view_that_would_write_is_refused_where_it_is_deployed(problems, body):
    source = f"def helper():\n    deeper()\n\ndef deeper():\n    state.delete(b'k')\n\n@view\ndef f():\n    {body}\n"
    (problem,) = problems(source)
    assert (problem.code, problem.line) == ("VIEW_WRITES", 8)


def test_a_view_with_many_ways_to_write_is_told_the_first_by_name_whatever_the_hash_seed(problems):
    """The sentence becomes part of a receipt where a source is refused on chain: no set's order may get into it."""
    names = [f"writer_{letter}" for letter in "hcfbgade"]
    helpers = "".join(f"def {name}():\n    state.delete(b'k')\n\n" for name in names)
    calls = "".join(f"    {name}()\n" for name in names)
    (problem,) = problems(f"{helpers}@view\ndef f():\n{calls}")
    assert problem.message == "The view f changes the state or emits, by way of writer_a."


def test_names_of_kinds_functions_and_constants_may_be_variables(bench):
    source = """
LIMIT = 3
@genesis
def genesis(view: int):
    state.put(b"v", view)

@view
def visit(genesis: bytes) -> int:
    visit = len(genesis)
    LIMIT = 5
    return visit + LIMIT
"""
    bench.deploy("it", source)
    assert bench.call("it.visit", b"abc", mode="view").result == 8


def test_docstrings_and_comments_are_free(bench):
    source = '"""Doc ä."""\n\n# note ü\n@export\ndef f() -> int:\n    """Doc."""\n    return 1  # one\n'
    bench.deploy("it", source)
    with_docs = bench.call("it.f").gas_used
    bench.deploy("it", "@export\ndef f() -> int:\n    return 1\n")
    assert bench.call("it.f").gas_used == with_docs

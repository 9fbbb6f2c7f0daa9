"""All problems of a source at once, also where Python's own parser would stop at the first."""

from __future__ import annotations

import pytest

from contracts.vm import compile_contract, find_problems
from contracts.vm.model.faults import ContractSourceError


def found(source: str) -> list[tuple[int, str]]:
    return [(one.line, one.code) for one in find_problems(source, "it")]


def test_a_good_source_has_no_problems_and_one_that_cannot_be_read_makes_no_strangers_of_its_names():
    assert find_problems("LIMIT = 2 ** 8\n\n@export\ndef f(a: int) -> int:\n    return a + LIMIT\n", "it") == ()
    source = "LIMIT = (1 2)\n\n@export\ndef f() -> int:\n    total = 1 1\n    return helper(total) + LIMIT\n\n"
    assert found(source + "def helper(a b):\n    return 1\n") == [(1, "SYNTAX"), (5, "SYNTAX"), (8, "SYNTAX")]
    source = "@export\ndef f():\n    pass\n"
    compile_contract(source, "it")
    assert find_problems(source, "it") == ()


def test_an_open_bracket_and_a_tab_do_not_hide_what_follows():
    source = """
@export
def first(a: int):
    x = (1 + a
    return x

@export
def second(b):
	y = 1
    return unknown

@export
def third(c: int):
    z = "open
    return c / 2
"""
    assert found(source) == [
        (4, "BRACKET_OPEN"),
        (8, "ANNOTATION_MISSING"),
        (9, "TAB"),
        (10, "NAME_UNKNOWN"),
        (14, "STRING_OPEN"),
        (15, "FLOAT"),
    ]


def test_each_statement_that_is_not_python_is_told_and_the_rest_is_checked():
    source = """
@export
def f(a: int) -> int:
    x = a a
    if x y:
        z = 1 / 2
    elif z z:
        pass
    else:
        print(x)
    for i in [1 2]:
        nothing(i)
    return x b

@export
def g(a b):
    return unknown
"""
    assert found(source) == [
        (4, "SYNTAX"),
        (5, "SYNTAX"),
        (6, "FLOAT"),
        (7, "SYNTAX"),
        (10, "NAME_UNKNOWN"),
        (11, "SYNTAX"),
        (12, "NAME_UNKNOWN"),
        (13, "SYNTAX"),
        (16, "SYNTAX"),
        (17, "NAME_UNKNOWN"),
    ]


def test_several_problems_of_one_statement_are_all_told():
    body = "x = unknown + '\\d' + r'a' + 1.5 + len + {1} / g(lambda y: nobody, *[z]) + ctx.nothing"
    codes = {code for _, code in found(f"@export\ndef f():\n    {body}\n")}
    assert codes == {
        "NAME_UNKNOWN", "ESCAPE", "STRING_PREFIX", "NUMBER", "NOT_A_VALUE", "NOT_IN_LANGUAGE", "FLOAT", "CONTEXT",
    }  # fmt: skip
    twice = [one.column for one in find_problems("@export\ndef f():\n    return one + two + '\\d' + '\\p'\n", "it")]
    assert twice == [12, 18, 24, 31]


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("def f():\n    pass\n@export\ndef f():\n    return unknown\n", [(4, "NAME_TWICE"), (5, "NAME_UNKNOWN")]),
        ("X = [len(1), f'{Y}', Z]\n", [(1, "CONSTANT"), (1, "CONSTANT"), (1, "NAME_UNKNOWN")]),
        ("X, Y = Z, 1\n", [(1, "CONSTANT"), (1, "NAME_UNKNOWN")]),
        ("X = 1 // 0\nY = X + 'a'\nZ = 1 + 'a'\n", [(1, "CONSTANT"), (3, "CONSTANT")]),
        ("if unknown:\n    x = 1 / 2\n", [(1, "NOT_IN_LANGUAGE"), (1, "NAME_UNKNOWN"), (2, "FLOAT")]),
        ("def f(a, a):\n    pass\n", [(1, "NAME_TWICE")]),
        ("def f():\n    with a as b:\n        c\n", [(2, "NOT_IN_LANGUAGE"), (2, "NAME_UNKNOWN"), (3, "NO_EFFECT")]),
        ("def f():\n    try:\n        return 1 / 1\n    except A:\n        return 2 / 1\n", [(3, "FLOAT"), (5, "FLOAT")]),
        ("def f():\n    return {a for b in c for d in e}\n", [(2, "COMPREHENSION"), (2, "NAME_UNKNOWN")]),
        ("def f():\n    return (nobody.x, [1][::y], (z := w))\n", [(2, "ATTRIBUTE"), (2, "NAME_UNKNOWN")]),
        ("def f():\n    nobody.x = 1\n    (a, b[c]) = 1, 2\n", [(2, "ASSIGNMENT"), (2, "NAME_UNKNOWN")]),
        ("def f():\n    def g(a):\n        return a + nobody\n", [(2, "NOT_IN_LANGUAGE"), (3, "NAME_UNKNOWN")]),
        ("import os\n@export\ndef f():\n    return os.getcwd() + nobody\n", [(1, "NOT_IN_LANGUAGE"), (4, "NAME_UNKNOWN")]),
        ("@exports\ndef f(a):\n    pass\n", [(1, "DECORATOR")]),
        ("x = '''abc\n\n@export\ndef f():\n    pass\n", [(1, "STRING_OPEN")]),
        ("def f():\n        x = 1\n    return x\n", [(3, "INDENT")]),
        ("def f():\nreturn 1\n", [(2, "SYNTAX")]),
        ("x = 1 + \\\n    nobody\n", [(1, "BACKSLASH"), (2, "NAME_UNKNOWN")]),
        ("@@@\n\ndef f(:\n))\n", [(1, "SYNTAX"), (4, "BRACKET")]),
    ],
)  # fmt: skip
def test_all_of_it_is_told(source, expected):
    assert [one for one in expected if one not in found(source)] == []


def test_columns_count_characters_and_thousands_of_slips_are_cut_off():
    (problem,) = find_problems("@export\ndef f():\n    return 'äöü' + nobody\n", "it")
    assert problem.column == 20
    assert len(find_problems("@export\ndef f():\n" + "    x = ? \n" * 4000, "it")) == 100
    assert len(find_problems("@export\ndef f():\n" + "    x = a a\n" * 2000, "it")) == 40


@pytest.mark.parametrize("source", ["", "x", "@export\ndef f():\n    return g()\n", "\x00", "((", "  x = 1\n"])
def test_what_is_refused_is_refused_for_one_of_its_problems(source: str):
    with pytest.raises(ContractSourceError) as refused:
        compile_contract(source, "it")
    assert refused.value.verdict.code in [one.code for one in find_problems(source, "it")]

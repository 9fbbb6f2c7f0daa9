"""What Python's parsers read differently from version to version never reaches them, and a verdict names no version."""

from __future__ import annotations

import pytest

from contracts.vm import ContractSourceError, InternalFault, compile_contract
from contracts.vm.frontend import parser
from contracts.vm.frontend.lexer_guard import prelex

# What newer Pythons parse and older ones do not (or in other words, or into another tree).
HOLES = {
    "an f-string with its own quotes inside": "x = f'{a['k']}'",
    "an f-string in an f-string": "x = f'{f'{a}'}'",
    "an f-string with a backslash inside": "x = f'{chr(10)}\\n'",
    "an f-string with a comment inside": "x = f'{a # b}'",
    "an f-string over lines": "x = f'''{\n a}'''",
    "an f-string with a star": "x = f'{*a}'",
    "an f-string with a star further on": "x = f'{1, *a}'",
    "an f-string with an open bracket": "x = f'{(a}'",
    "an f-string with another prefix": "x = rf'{a}'",
    "an f-string in capitals": "x = F'{a['k']}'",
    "a template string": "x = t'{a}'",
    "a raw template string": "x = rt'{a}'",
    "a type statement": "type X = int",
    "a type statement with parameters": "type X[T] = list[T]",
    "type parameters of a function": "def g[T](a): pass",
    "type parameters with defaults": "def g[T = int](a): pass",
    "a class with type parameters": "class A[T]: pass",
    "except without brackets": "try:\n        pass\n    except A, B:\n        pass",
    "except with a star": "try:\n        pass\n    except* A:\n        pass",
    "return in finally": "try:\n        pass\n    finally:\n        return 1",
    "parenthesised with": "with (a as b, c as d):\n        pass",
    "a lazy import": "lazy import os",
    "an import of all": "from os import *",
    "unpacking in a comprehension": "x = [*a for a in b]",
    "unpacking in a dict comprehension": "x = {**a for a in b}",
    "unpacking in an index": "x = a[*b]",
    "unpacking in a return": "return *a, 1",
    "unpacking in a loop": "for x in *a, 1:\n        pass",
    "unpacking in an annotation": "def g(*a: *b): pass",
    "a number that runs into a word": "x = 1if a else 2",
    "a hexadecimal number that runs into a word": "x = 0xfor a in b",
    "a number with a leading zero": "x = 017",
    "a number with two underscores": "x = 1__0",
    "a number that ends in an underscore": "x = 1_",
    "a number of more digits than Python reads": "x = " + "9" * 5000,
    "an unknown escape": "x = '\\d'",
    "a named character": "x = '\\N{BULLET}'",
    "an octal escape": "x = '\\400'",
    "a letter outside of ASCII": "ｘ = 1",
    "a name that Python would fold": "ﬁ = 1",
    "await outside of async": "x = await a",
    "async in a comprehension": "x = [a async for a in b]",
    "half a character in a comment": "x = 1 # \ud800",
    "a comment of control characters": "x = 1 # \x0c",
    "a page break": "\x0cx = 1",
    "brackets without end": "x = " + "(" * 300 + ")" * 300,
    "brackets without end in an f-string": "x = f'{" + "(" * 39 + ")" * 39 + "}'",
    "signs without end": "x = " + "-" * 4000 + "1",
    "nots without end": "x = " + "not " * 4000 + "1",
    "powers without end": "x = " + "2 ** " * 4000 + "1",
    "conditions without end": "x = " + "1 if 1 else " * 1000 + "1",
    "lambdas without end": "x = " + "lambda: " * 1000 + "1",
    "texts without end": "x = " + "'a' " * 4000,
    "attributes without end": "x = a" + ".b" * 4000,
    "indices without end": "x = a" + "[0]" * 4000,
    "calls without end": "x = a" + "()" * 4000,
    "types without end": "x: " + "int | " * 4000 + "int = 1",
}


@pytest.mark.parametrize("body", HOLES.values(), ids=HOLES.keys())
def test_the_pre_lexer_refuses(body):
    assert prelex(f"@export\ndef f(a, b):\n    {body}\n").diagnostics


@pytest.mark.parametrize("body", HOLES.values(), ids=HOLES.keys())
def test_the_verdict_on_it_is_the_pre_lexers(body):
    source = f"@export\ndef f(a: object, b: object):\n    {body}\n"
    with pytest.raises(ContractSourceError) as caught:
        compile_contract(source, "it")
    assert caught.value.verdict in prelex(source).diagnostics


def test_the_verdict_on_what_python_cannot_parse_has_none_of_pythons_words():
    with pytest.raises(ContractSourceError) as caught:
        compile_contract("@export\ndef f():\n    x = 1 1\n", "it")
    assert caught.value.diagnostics[0].fix.startswith("Python says")
    assert "Python says" not in str(caught.value.verdict)
    assert (caught.value.verdict.code, caught.value.verdict.line) == ("SYNTAX", 1)


def test_a_parser_that_runs_out_of_stack_gives_no_verdict(monkeypatch):
    def fail(*_args, **_options):
        raise RecursionError

    with monkeypatch.context() as patched:
        patched.setattr(parser.ast, "parse", fail)
        with pytest.raises(InternalFault):
            compile_contract("@export\ndef f():\n    pass\n", "it")


def test_names_of_other_pythons_are_names_and_a_problem_in_an_f_string_is_told_there(value, problems):
    assert value("type + match + case + lazy", before="type = 1\nmatch = 2\ncase = 3\nlazy = 4\n") == 10
    (problem,) = problems("@export\ndef f():\n    return 'a' f'b{1}c{nobody}'\n")
    assert (problem.line, problem.column, problem.code) == (3, 12, "NAME_UNKNOWN")

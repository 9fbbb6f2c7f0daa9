"""Deeply nested values and sources."""

from __future__ import annotations

from network.lab.hostile.program import REFUSED, Program, body, refused, source, spent

_DEEP = "x = []\nfor i in range({}):\n    x = [x]\n"
_DEEP_DICT = "x = {{}}\nfor i in range({}):\n    x = {{'a': x}}\n"


def _sum_of(count: int) -> str:
    return " + ".join(["1"] * count)


PROGRAMS: tuple[Program, ...] = (
    body("deep-stored", "VALUE_ERROR", _DEEP.format(1000) + "state.put(b'k', x)"),
    body("deep-dict-stored", "VALUE_ERROR", _DEEP_DICT.format(1000) + "state.put(b'k', x)"),
    body("deep-emitted", "VALUE_ERROR", _DEEP.format(1000) + "emit('a', {'x': x})"),
    body("deep-returned", "VALUE_ERROR", _DEEP.format(1000) + "return x"),
    body(
        "deep-passed",
        "ARGUMENTS_INVALID",
        _DEEP.format(1000) + "call('other', 'f', x)",
        others={"other": "@export\ndef f(x: object):\n    pass\n"},
    ),
    body("deep-compared", "VALUE_ERROR", _DEEP.format(1000) + "y = x\nreturn x == [y]"),
    body(
        "deep-dict-compared",
        "VALUE_ERROR",
        _DEEP_DICT.format(100) + "y = {}\nfor i in range(100):\n    y = {'a': y}\nreturn x == y",
    ),
    body("deep-searched", "VALUE_ERROR", _DEEP.format(100) + "y = x\nreturn [y] in [[x], x]"),
    spent("deep-to-the-end-of-gas", "x = []\nwhile True:\n    x = [x]"),
    spent("deep-dict-to-the-end-of-gas", "x = {}\nwhile True:\n    x = {1: x}"),
    spent("deep-tuple-to-the-end-of-gas", "x = ()\nwhile True:\n    x = (x,)"),
    spent("deep-dropped-again", "while True:\n    x = []\n    for i in range(1000):\n        x = [x]"),
    body("deep-text-of-value", "TYPE_ERROR", _DEEP.format(1000) + "return str(x)"),
    body("deep-as-a-truth", "OK", _DEEP.format(1000) + "return bool(x)"),
    refused("brackets", "NESTED_TOO_DEEP", "return " + "(" * 5000 + "1" + ")" * 5000),
    refused("lists-in-lists", "NESTED_TOO_DEEP", "return " + "[" * 100 + "]" * 100),
    refused("dicts-in-dicts", "NESTED_TOO_DEEP", "return " + "{1:" * 100 + "1" + "}" * 100),
    refused("calls-in-calls", "NESTED_TOO_DEEP", "return " + "len(" * 100 + "''" + ")" * 100),
    refused("minus-minus", "STATEMENT_TOO_LONG", "return " + "-" * 5000 + "1"),
    refused("not-not", "STATEMENT_TOO_LONG", "return " + "not " * 5000 + "1"),
    refused("invert-invert", "STATEMENT_TOO_LONG", "return " + "~" * 20000 + "1"),
    refused("sum-of-thousands", "STATEMENT_TOO_LONG", "return " + _sum_of(5000)),
    refused("powers-of-powers", "STATEMENT_TOO_LONG", "return " + "2 ** " * 3000 + "1"),
    refused("comparisons-of-comparisons", "STATEMENT_TOO_LONG", "return " + "1 < " * 3000 + "1"),
    refused("or-or-or", "STATEMENT_TOO_LONG", "return " + "0 or " * 3000 + "1"),
    refused("if-else-if-else", "STATEMENT_TOO_LONG", "return " + "1 if 0 else " * 3000 + "1"),
    refused("attributes-of-attributes", "STATEMENT_TOO_LONG", "return x" + ".a" * 5000),
    refused("items-of-items", "STATEMENT_TOO_LONG", "x = 1\nreturn x" + "[0]" * 3000),
    refused("calls-of-calls", "STATEMENT_TOO_LONG", "return g" + "()" * 3000),
    refused("minus-up-to-the-limit", "NESTED_TOO_DEEP", "return " + "-" * 140 + "1"),
    refused("texts-beside-texts", "STATEMENT_TOO_LONG", "return " + "'a' " * 3000),
    refused("targets", "STATEMENT_TOO_LONG", "x = " * 3000 + "1"),
    refused("lambda-in-lambda", "NOT_IN_LANGUAGE", "return " + "lambda: " * 3000 + "1"),
    source(
        "elif-without-end",
        REFUSED + "ELIF_TOO_MANY",
        "@export\ndef f(a: int):\n    if a == 0:\n        pass\n"
        + "".join(f"    elif a == {n}:\n        pass\n" for n in range(1500)),
    ),
    source(
        "blocks-in-blocks",
        REFUSED + "NESTED_TOO_DEEP",
        "@export\ndef f():\n" + "".join(" " * n + "if 1:\n" for n in range(4, 99)) + " " * 99 + "pass\n",
    ),
    source(
        "blocks-by-one-space",
        REFUSED + "NESTED_TOO_DEEP",
        "@export\ndef f():\n" + "".join(" " * n + "while 1:\n" for n in range(1, 30)) + " " * 30 + "pass\n",
    ),
    source(
        "types-in-types",
        REFUSED + "NESTED_TOO_DEEP",
        "@export\ndef f(a: " + "list[" * 100 + "int" + "]" * 100 + "):\n    pass\n",
    ),
    source(
        "types-without-end",
        REFUSED + "STATEMENT_TOO_LONG",
        "@export\ndef f(a: " + " | ".join(["int"] * 3000) + "):\n    pass\n",
    ),
    source("decorators-in-rows", REFUSED + "DECORATOR", "@export\n" * 3000 + "def f():\n    pass\n"),
    source(
        "functions-in-functions",
        REFUSED + "NOT_IN_LANGUAGE",
        "@export\ndef f():\n    def g():\n        def h():\n            pass\n",
    ),
    source("bracket-never-closed", REFUSED + "BRACKET_OPEN", "@export\ndef f():\n    return (" + "\n" * 50000),
    source("text-never-closed", REFUSED + "STRING_OPEN", "@export\ndef f():\n    return '" + "a" * 50000 + "\n"),
    source(
        "long-text-never-closed", REFUSED + "STRING_OPEN", "@export\ndef f():\n    return '''" + "\\a'" * 15000 + "\n"
    ),
    source("quotes-without-end", REFUSED + "STRING_OPEN", "@export\ndef f():\n    return " + "'" * 50001 + "\n"),
)
"""Depth, in values and in sources."""

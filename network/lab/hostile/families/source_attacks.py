"""Malicious sources, constants, defaults and arguments."""

from __future__ import annotations

from typing import Any

from network.lab.hostile.program import REFUSED, SPENT, Program, body, source

_HEAD = "@export\ndef f():\n"
_OPENERS = "".join(f"X{n} = (X{n - 1}, X{n - 1})\n" for n in range(1, 60))
_LISTS = "".join(f"X{n} = [X{n - 1}, X{n - 1}]\n" for n in range(1, 60))


def _nested(depth: int) -> list[Any]:
    value: list[Any] = []
    for _ in range(depth):
        value = [value]
    return value


PROGRAMS: tuple[Program, ...] = (
    source("sixty-thousand-lines", REFUSED + "SOURCE_TOO_LONG", _HEAD + "    x = 1\n" * 60_000),
    source("sixty-thousand-empty-lines", REFUSED + "NO_ENTRY", "\n" * 60_000),
    source("sixty-thousand-bytes-of-comment", "OK", _HEAD + "    pass\n#" + "x" * 59_900 + "\n"),
    source("sixty-thousand-bytes-of-text", "OK", _HEAD + "    x = '" + "x" * 59_900 + "'\n"),
    source("sixty-thousand-wide-letters", REFUSED + "SOURCE_TOO_LONG", _HEAD + "    x = '" + "\u20ac" * 59_000 + "'\n"),
    source("statements-up-to-the-limit", "OK", _HEAD + "    x = 1\n" * 5_900),
    source("calls-up-to-the-limit", "OK", _HEAD + "    x = len([])\n" * 3_700),
    source(
        "f-strings-up-to-the-limit", "OK", _HEAD + "    x = 1\n" + "    y = f'{x}{x}{x}{x}{x}{x}{x}{x}{x}{x}'\n" * 1_390
    ),
    source("variables-up-to-the-limit", "OK", _HEAD + "".join(f"    v{n} = {n}\n" for n in range(3_000))),
    source(
        "functions-up-to-the-limit",
        "OK",
        _HEAD + "    pass\n\n\n" + "".join(f"def g{n}():\n    pass\n" for n in range(2_000)),
    ),
    source("constants-up-to-the-limit", "OK", "".join(f"C{n} = {n}\n" for n in range(4_000)) + _HEAD + "    pass\n"),
    source("problems-without-end", REFUSED + "NAME_UNKNOWN", _HEAD + "    x = y\n" * 5_900),
    source("unknown-methods-without-end", REFUSED + "METHOD_UNKNOWN", _HEAD + "    x = 1\n" + "    x.y()\n" * 5_000),
    source("stray-letters-without-end", REFUSED + "CHARACTER", _HEAD + "    " + "$?!" * 15_000 + "\n"),
    source("dollar-lines-without-end", REFUSED + "CHARACTER", _HEAD + "$\n" * 20_000),
    source("quotes-and-escapes", REFUSED + "ESCAPE", _HEAD + "    x = '" + "\\q" * 25_000 + "'\n"),
    source("braces-in-f-string", REFUSED + "F_STRING", _HEAD + "    x = f'" + "{" * 25_001 + "'\n"),
    source(
        "views-that-call-views",
        "OK",
        _HEAD
        + "    pass\n\n\n"
        + "".join(f"@view\ndef v{n}():\n    return v{(n + 1) % 700}()\n\n\n" for n in range(700)),
    ),
    source(
        "elif-chain-in-loops",
        "OK",
        _HEAD
        + "    x = 1\n    if x == 0:\n        pass\n"
        + "".join(f"    elif x == {n}:\n        pass\n" for n in range(59)),
    ),
    source("constant-text-bomb", REFUSED + "CONSTANT", "X = 'a' * 10 ** 9\n\n\n" + _HEAD + "    pass\n"),
    source("constant-shift-bomb", REFUSED + "CONSTANT", "X = 1 << 10 ** 70\n\n\n" + _HEAD + "    pass\n"),
    source("constant-power-bomb", REFUSED + "CONSTANT", "X = 9 ** 9 ** 9 ** 9\n\n\n" + _HEAD + "    pass\n"),
    source("constant-division", REFUSED + "CONSTANT", "X = 1 // 0\n\n\n" + _HEAD + "    pass\n"),
    source("constant-of-mixed-types", REFUSED + "CONSTANT", "X = 'a' + 1\n\n\n" + _HEAD + "    pass\n"),
    source("constant-odd-key", REFUSED + "CONSTANT", "X = {None: 1}\n\n\n" + _HEAD + "    pass\n"),
    source("constant-before-its-value", REFUSED + "NAME_UNKNOWN", "X = Y\nY = 1\n\n\n" + _HEAD + "    pass\n"),
    source("constant-of-itself", REFUSED + "NAME_UNKNOWN", "X = [X]\n\n\n" + _HEAD + "    pass\n"),
    source("constant-list-in-lists", REFUSED + "CONSTANT", "X0 = [1]\n" + _LISTS + _HEAD + "    return X59\n"),
    source("constant-tuple-in-tuples", REFUSED + "CONSTANT", "X0 = (1, 2)\n" + _OPENERS + _HEAD + "    return X59\n"),
    source(
        "constant-texts-kept",
        REFUSED + "CONSTANT",
        "".join(f"X{n} = 'a' * 60000\n" for n in range(1000)) + _HEAD + "    pass\n",
    ),
    source("constant-text-used-often", REFUSED + "CONSTANT", "X = 'a' * 6000000\n" + _HEAD + "    x = X\n" * 5_000),
    source("default-bomb", REFUSED + "CONSTANT", "@export\ndef f(a: str = 'a' * 10 ** 9):\n    pass\n"),
    source("default-division", REFUSED + "CONSTANT", "@export\ndef f(a: int = 1 // 0):\n    pass\n"),
    source("default-of-itself", REFUSED, "@export\ndef f(a: int = 1, b: int = a):\n    pass\n"),
    source(
        "default-list-shared",
        "OK",
        "@export\ndef f(a: list = []):\n    require(g() == 1 and g() == 1, 'SHARED')\n\n\n"
        "def g(x=[]):\n    x.append(1)\n    return len(x)\n",
    ),
    source(
        "constant-list-changed",
        "OK",
        "X = [[1]]\n\n\n@export\ndef f():\n    x = X\n    x[0].append(2)\n    require(X == [[1]], 'CHANGED')\n",
    ),
    source(
        "constant-list-used-often",
        SPENT,
        "X = [[1] * 100] * 20\n\n\n@export\ndef f():\n    while True:\n        x = X\n",
    ),
    body("argument-too-deep", "ARGUMENTS_INVALID", "return a", args=(_nested(50),)),
    body("argument-very-deep", "ARGUMENTS_INVALID", "return a", args=(_nested(900),)),
    source("argument-too-many", "ARGUMENTS_INVALID", _HEAD + "    pass\n", args=tuple(range(5000))),
    body("argument-wide", "OK", "return len(a)", args=(list(range(4000)),)),
    body("argument-of-dicts", "OK", "return len(a)", args=([{} for _ in range(8000)],)),
    body("argument-of-huge-numbers", "OK", "return len(a)", args=([2**255] * 400,)),
    body("argument-number-beyond", "ARGUMENTS_INVALID", "return a", args=(2**300,)),
    body("argument-key-beyond", "ARGUMENTS_INVALID", "return a", args=({2**61 - 1: 1},)),
    body("argument-key-long", "ARGUMENTS_INVALID", "return a", args=({b"k" * 15000: 1},)),
    body("argument-sent-back", "OK", "return [a, a, a, a]", args=([b"x" * 100] * 100,)),
    body("argument-stored", "VALUE_ERROR", "state.put(b'k', [a, a, a])", args=(b"x" * 9000,)),
    source("argument-of-wrong-type", "ARGUMENTS_INVALID", "@export\ndef f(a: int):\n    pass\n", args=(True,)),
    source(
        "argument-of-wrong-inner-type",
        "ARGUMENTS_INVALID",
        "@export\ndef f(a: list[dict[str, int]]):\n    pass\n",
        args=([{"a": 1}] * 500 + [{"a": "1"}],),
    ),
    source("argument-none", "ARGUMENTS_INVALID", "@export\ndef f(a: int | str):\n    pass\n", args=(None,)),
    source("argument-missing", "ARGUMENTS_INVALID", "@export\ndef f(a: int, b: int):\n    pass\n", args=(1,)),
)
"""Everything that reaches the machine before the first statement runs."""

"""No regular expression doubles its time with each repetition of what it reads: texts of strangers are matched with them.

Each pattern is taken apart. What stands in a repeated part is repeated behind what comes before it, with an end that fits
nowhere: a part that can read the same text in two ways then tries them all.
"""

from __future__ import annotations

import ast
import itertools
import re
import time
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)
    from re import _parser as parser  # type: ignore[attr-defined]

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("clients", "consensus", "contracts", "network", "node", "pages")
FUNCTIONS = frozenset({"compile", "match", "fullmatch", "search", "sub", "findall", "finditer", "split"})
ALPHABET = "aA0_ \n\\'\"/.:-[]{}#=<>(),\xe9"
SAMPLES_MAX_COUNT = 12
REPEATED_COUNTS = (6, 10, 14, 17, 20, 22, 24)
SPENT_MAX_S = 0.1


def patterns(source: str) -> Iterator[tuple[str, int]]:
    """Yield the patterns that stand in a source, and their flags."""
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Call) or not isinstance(node.func, ast.Attribute) or not node.args:
            continue
        if getattr(node.func.value, "id", "") != "re" or node.func.attr not in FUNCTIONS:
            continue
        if not isinstance(node.args[0], ast.Constant) or not isinstance(node.args[0].value, str):
            continue
        flags = 0
        for part in ast.walk(ast.Module([ast.Expr(one) for one in node.args[1:]], [])):
            flags |= getattr(re, part.attr, 0) if isinstance(part, ast.Attribute) and part.attr.isupper() else 0
        yield node.args[0].value, int(flags)


def samples(items: Any) -> list[str]:
    """Return some texts that a parsed pattern reads, different ones for different ways."""
    found = [""]
    for item in items:
        found = [before + text for before, text in itertools.product(found, _of(*item))][:SAMPLES_MAX_COUNT]
    return found


def _of(kind: Any, value: Any) -> list[str]:
    name = str(kind)
    if name == "LITERAL":
        return [chr(value)]
    if name in ("NOT_LITERAL", "IN", "ANY", "CATEGORY"):
        return [letter for letter in ALPHABET if _reads(kind, value, letter)] or [""]
    if name == "BRANCH":
        each = [samples(branch) for branch in value[1]]
        return [text for texts in itertools.zip_longest(*each) for text in texts if text is not None]
    if name in ("SUBPATTERN", "ATOMIC_GROUP"):
        return samples(value[-1] if name == "SUBPATTERN" else value)
    if name.endswith("_REPEAT"):
        return [text * max(value[0], 1) for text in samples(value[2])] + ([""] if value[0] == 0 else [])
    return [""]


def _reads(kind: Any, value: Any, letter: str) -> bool:
    name = str(kind)
    if name == "NOT_LITERAL":
        return ord(letter) != value
    if name == "ANY":
        return True
    if name == "CATEGORY":
        negated, word = "_NOT_" in str(value), str(value).rpartition("_")[2]
        return {"DIGIT": letter.isdigit(), "SPACE": letter.isspace()}.get(word, letter.isalnum()) != negated
    wanted = True
    for part, inner in value:
        one = str(part)
        if one == "NEGATE":
            wanted = False
        elif {
            "LITERAL": lambda inner: ord(letter) == inner,
            "RANGE": lambda inner: inner[0] <= ord(letter) <= inner[1],
            "CATEGORY": lambda inner: _reads("CATEGORY", inner, letter),
        }[one](inner):
            return wanted
    return not wanted


def repeated(items: Any, before: list[str]) -> Iterator[tuple[str, str]]:
    """Yield what may stand before a repeated part, and what that part reads."""
    for place, (kind, value) in enumerate(items):
        here = [one + text for one in before[:4] for text in samples(items[:place])[:4]]
        name = str(kind)
        if name.endswith("_REPEAT"):
            if value[1] > 1:
                yield from itertools.product(here, samples(value[2]))
            yield from repeated(value[2], here)
        elif name == "BRANCH":
            for branch in value[1]:
                yield from repeated(branch, here)
        elif name == "SUBPATTERN":
            yield from repeated(value[-1], here)


def slow(pattern: str, flags: int) -> str | None:
    """Return a text at which a pattern takes too long, if one is found."""
    compiled, tried = re.compile(pattern, flags), set[str]()
    for before, text in repeated(parser.parse(pattern, flags), [""]):
        for count in REPEATED_COUNTS:
            whole = before + text * count + "\0"
            if whole not in tried:
                tried.add(whole)
                started = time.thread_time()
                compiled.fullmatch(whole)
                compiled.search(whole)
                if time.thread_time() - started > SPENT_MAX_S:
                    return whole
    return None


def test_no_pattern_doubles_its_time():
    found = {}
    count = 0
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*.py")):
            for pattern, flags in patterns(path.read_text("utf-8")):
                count += 1
                if (text := slow(pattern, flags)) is not None:
                    found[f"{path.relative_to(ROOT)}: {pattern}"] = text
    assert count > 60
    assert found == {}


@pytest.mark.parametrize(
    "pattern", [r"'''(?:[^\\]|\\.|\\\n)*?'''", r"(a+)+b", r"(?:a|ab|b)*c", r"x(?:\s|\n\s|[ ]x)*y", r"(?:\w|\d\d)*!"]
)
def test_a_pattern_that_does_is_found(pattern):
    assert slow(pattern, re.DOTALL) is not None

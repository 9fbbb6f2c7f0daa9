"""The syntax trees of the code base, kept for the tests of one module."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"), filename=str(path))


@cache
def nodes_of(path: Path) -> tuple[ast.AST, ...]:
    return tuple(ast.walk(tree_of(path)))


def forget() -> None:
    """Let them go: three million objects, which every later full collection of garbage would walk."""
    nodes_of.cache_clear()
    tree_of.cache_clear()

"""Reads source files byte for byte, and tells contracts from tests."""

from __future__ import annotations

import ast
import re
from pathlib import Path

from consensus.errors import BlockRobotError

_KINDS = frozenset({"export", "view", "genesis", "migrate"})
_MARK = re.compile(rb"^@(?:export|view|genesis|migrate)\b", re.MULTILINE)


def read_source(path: Path) -> str:
    """Raises FILE_UNUSABLE if it is not UTF-8, OSError."""
    try:
        return path.read_bytes().decode()
    except UnicodeDecodeError:
        raise BlockRobotError("FILE_UNUSABLE", f"{path} is not a text file in UTF-8.") from None


def is_contract_file(path: Path) -> bool:
    """Return whether a file imports nothing and marks an entry."""
    try:
        data = path.read_bytes()
        body = ast.parse(data).body if _MARK.search(data) else []
    except (OSError, SyntaxError, ValueError, RecursionError, MemoryError):
        return False
    if any(isinstance(item, ast.Import | ast.ImportFrom) for item in body):
        return False
    marks = [mark for item in body if isinstance(item, ast.FunctionDef) for mark in item.decorator_list]
    return any(isinstance(mark, ast.Name) and mark.id in _KINDS for mark in marks)

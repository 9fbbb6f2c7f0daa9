"""Reads source files byte for byte, and tells contracts from tests."""

from __future__ import annotations

import ast
import re
from pathlib import Path

from consensus.errors import BlockRobotError

SOURCE_FILE_MAX_BYTES = 1024 * 1024
"""More than a source may have, so that a longer one is told where it ends being one."""

_KINDS = frozenset({"export", "view", "genesis", "migrate"})
_MARK = re.compile(rb"^@(?:export|view|genesis|migrate)\b", re.MULTILINE)


def read_source_bytes(path: Path) -> bytes:
    """Raises FILE_UNUSABLE if too large, OSError."""
    with path.open("rb") as file:
        data = file.read(SOURCE_FILE_MAX_BYTES + 1)
    if len(data) > SOURCE_FILE_MAX_BYTES:
        raise BlockRobotError("FILE_UNUSABLE", f"{path} is larger than {SOURCE_FILE_MAX_BYTES} bytes.")
    return data


def read_source(path: Path) -> str:
    """Raises FILE_UNUSABLE if too large or not UTF-8, OSError."""
    try:
        return read_source_bytes(path).decode()
    except UnicodeDecodeError:
        raise BlockRobotError("FILE_UNUSABLE", f"{path} is not a text file in UTF-8.") from None


def is_contract_file(path: Path) -> bool:
    """Return whether a file imports nothing and marks an entry."""
    try:
        data = read_source_bytes(path)
        body = ast.parse(data).body if _MARK.search(data) else []
    except (BlockRobotError, OSError, SyntaxError, ValueError, RecursionError, MemoryError):
        return False
    if any(isinstance(item, ast.Import | ast.ImportFrom) for item in body):
        return False
    marks = [mark for item in body if isinstance(item, ast.FunctionDef) for mark in item.decorator_list]
    return any(isinstance(mark, ast.Name) and mark.id in _KINDS for mark in marks)

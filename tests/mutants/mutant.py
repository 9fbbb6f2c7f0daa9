"""What a source mutant is: one change of the product's source, as a real mistake would make it."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path


class Kind(StrEnum):
    """What a mutant's mistake would be about."""

    AUTHORISATION = "authorisation"
    CONSENT = "consent"
    ERASURE = "erasure"
    FOREIGN_TEXT = "foreign-text"
    GAS = "gas"
    HIDING = "hiding"
    JOURNAL = "journal"
    KEY_FILES = "key-files"
    MANDATES = "mandates"
    PAIRING = "pairing"
    PROOFS = "proofs"
    QUOTAS = "quotas"
    VOTING = "voting"


@dataclass(frozen=True)
class DroppedCheck:
    """The `number`-th check of a module that refuses with `code` never refuses.

    Such a check is `if ...: raise BlockRobotError("CODE", ...)`, or in a contract `require(..., "CODE", ...)`.
    """

    kind: Kind
    file: str
    code: str
    number: int
    killed_by: str

    @property
    def name(self) -> str:
        """File, code and number, as a command line takes it."""
        return f"{self.file}:{self.code}:{self.number}"

    def apply(self, source: str) -> str:
        """Return the source with the check dropped. Raises ValueError if there is none."""
        conditions = sorted(_conditions(ast.parse(source), self.code), key=lambda item: (item.lineno, item.col_offset))
        if len(conditions) <= self.number:
            raise ValueError(f"{self.name}: {len(conditions)} such checks")
        condition = conditions[self.number]
        is_refusal = not _is_required(ast.parse(source), condition)
        return _replace(source, condition, "False" if is_refusal else "True")


@dataclass(frozen=True)
class Replaced:
    """A text that stands once in a module is another one."""

    kind: Kind
    file: str
    name: str
    old: str
    new: str
    killed_by: str

    def apply(self, source: str) -> str:
        """Return the changed source. Raises ValueError if the text does not stand there once."""
        if source.count(self.old) != 1:
            raise ValueError(f"{self.name}: the text stands {source.count(self.old)} times in {self.file}")
        return source.replace(self.old, self.new)


Mutant = DroppedCheck | Replaced


def apply_to(mutant: Mutant, root: Path) -> str:
    """Return what the mutant's file of a tree would be."""
    return mutant.apply((root / mutant.file).read_text(encoding="utf-8"))


def _conditions(tree: ast.Module, code: str) -> list[ast.expr]:
    found: list[ast.expr] = []
    for node in ast.walk(tree):
        match node:
            case ast.If(test=test, body=[ast.Raise(exc=ast.Call(args=[ast.Constant(value=value), *_]))]) if (
                value == code
            ):
                found.append(test)
            case ast.Call(func=ast.Name(id="require"), args=[test, ast.Constant(value=value), *_]) if value == code:
                found.append(test)
    return found


def _is_required(tree: ast.Module, condition: ast.expr) -> bool:
    place = (condition.lineno, condition.col_offset)
    calls = (node for node in ast.walk(tree) if isinstance(node, ast.Call) and node.args)
    required = (call.args[0] for call in calls if isinstance(call.func, ast.Name) and call.func.id == "require")
    return any((first.lineno, first.col_offset) == place for first in required)


def _replace(source: str, expression: ast.expr, text: str) -> str:
    lines = source.encode().splitlines(keepends=True)
    first, last = expression.lineno - 1, (expression.end_lineno or expression.lineno) - 1
    head = b"".join(lines[:first]) + lines[first][: expression.col_offset]
    tail = lines[last][expression.end_col_offset :] + b"".join(lines[last + 1 :])
    return (head + text.encode() + tail).decode()

"""The ways a contract can fail, at deployment and at run time. Must never carry contract data that was not public anyway.

`Fault` is what a contract's own conduct leads to: a code, a sentence, a line; it decides a receipt. `InternalFault` is
the interpreter's own failure; it must never decide one.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from consensus.errors import BlockRobotError

OK = "OK"
OUT_OF_GAS = "OUT_OF_GAS"
MEMORY_BUDGET = "MEMORY_BUDGET"
CALL_DEPTH = "CALL_DEPTH"
WRITE_BUDGET = "WRITE_BUDGET"
EVENT_BUDGET = "EVENT_BUDGET"
TYPE_ERROR = "TYPE_ERROR"
VALUE_ERROR = "VALUE_ERROR"
KEY_ERROR = "KEY_ERROR"
INDEX_ERROR = "INDEX_ERROR"
ZERO_DIVISION = "ZERO_DIVISION"
INT_OVERFLOW = "INT_OVERFLOW"
NAME_UNSET = "NAME_UNSET"
ENTRY_UNKNOWN = "ENTRY_UNKNOWN"
ARGUMENTS_INVALID = "ARGUMENTS_INVALID"
REENTRANT = "REENTRANT"
VIEW_WRITES = "VIEW_WRITES"
LIFECYCLE_ONLY = "LIFECYCLE_ONLY"

VM_CODES = frozenset(
    {
        OK, OUT_OF_GAS, MEMORY_BUDGET, CALL_DEPTH, WRITE_BUDGET, EVENT_BUDGET, TYPE_ERROR, VALUE_ERROR, KEY_ERROR,
        INDEX_ERROR, ZERO_DIVISION, INT_OVERFLOW, NAME_UNSET, ENTRY_UNKNOWN, ARGUMENTS_INVALID, REENTRANT, VIEW_WRITES,
        LIFECYCLE_ONLY,
    }
)  # fmt: skip
_AUTHOR_CODE = re.compile(r"[A-Z][A-Z0-9_]{1,62}[A-Z0-9]", re.ASCII)


def is_author_code(code: str) -> bool:
    """Whether a contract may fail with this code: UPPER_SNAKE, 3 to 64 characters, not one of the machine's own."""
    return _AUTHOR_CODE.fullmatch(code) is not None and code not in VM_CODES


class Fault(Exception):  # noqa: N818 - a receipt's code, not a programming error
    """A contract's failure. `line` is filled in by the innermost statement that was running."""

    def __init__(self, code: str, message: str, line: int | None = None) -> None:
        self.code = code
        self.message = message
        self.line = line
        super().__init__(f"{code}: {message}")


class InternalFault(Exception):  # noqa: N818 - the counterpart of Fault
    """The interpreter or its host failed in a way nobody foresaw; the call has no result at all."""


@dataclass(frozen=True, slots=True)
class Diagnostic:
    """One problem of a source: where it is (1-based line and column), what it is, and what to write instead."""

    code: str
    line: int
    column: int
    message: str
    fix: str

    def __str__(self) -> str:
        return f"{self.line}:{self.column} {self.code}: {self.message} {self.fix}"


class ContractSourceError(BlockRobotError):
    """A source that is not in the contract language; `diagnostics` lists the problems found, by line.

    They are for the author: where Python's parser refuses a source, its words and places differ by version. `verdict`
    is the one problem that every machine names alike, which is all that a receipt may say.
    """

    def __init__(self, contract: str, diagnostics: tuple[Diagnostic, ...], verdict: Diagnostic | None = None) -> None:
        self.diagnostics = diagnostics
        self.verdict = diagnostics[0] if verdict is None else verdict
        listing = "\n".join(f"{contract}:{diagnostic}" for diagnostic in diagnostics)
        super().__init__("CONTRACT_SOURCE_INVALID", f"{len(diagnostics)} problem(s) in {contract}:\n{listing}")

"""Failures at deployment and run time; they carry only public contract data."""

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
    """Author codes are UPPER_SNAKE, 3 to 64 characters, not the machine's."""
    return _AUTHOR_CODE.fullmatch(code) is not None and code not in VM_CODES


class Fault(Exception):  # noqa: N818 - a receipt's code, not a programming error
    """A contract's failure; the innermost running statement sets `line`."""

    def __init__(self, code: str, message: str, line: int | None = None) -> None:
        self.code = code
        self.message = message
        self.line = line
        super().__init__(f"{code}: {message}")


class InternalFault(Exception):  # noqa: N818 - the counterpart of Fault
    """An unforeseen interpreter or host failure; the call has no result."""


@dataclass(frozen=True, slots=True)
class Diagnostic:
    """A source problem: 1-based line and column, and the suggested fix."""

    code: str
    line: int
    column: int
    message: str
    fix: str

    def __str__(self) -> str:
        return f"{self.line}:{self.column} {self.code}: {self.message} {self.fix}"


class ContractSourceError(BlockRobotError):
    """A source outside the contract language; `diagnostics` lists the problems for its author.

    Parser wording differs by Python version; `verdict` is identical on all machines and fit for receipts.
    """

    def __init__(self, contract: str, diagnostics: tuple[Diagnostic, ...], verdict: Diagnostic | None = None) -> None:
        self.diagnostics = diagnostics
        self.verdict = diagnostics[0] if verdict is None else verdict
        listing = "\n".join(f"{contract}:{diagnostic}" for diagnostic in diagnostics)
        super().__init__("CONTRACT_SOURCE_INVALID", f"{len(diagnostics)} problem(s) in {contract}:\n{listing}")

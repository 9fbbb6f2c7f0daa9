"""Command exit codes and their mapping from catalogue errors."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from consensus.errors import ErrorEntry

EXIT_DONE = 0
EXIT_FAILED = 1
EXIT_USAGE = 2
EXIT_NOT_FOUND = 3
EXIT_REFUSED = 4
EXIT_NOT_FINAL = 5

MEANINGS: Mapping[int, str] = MappingProxyType(
    {
        EXIT_DONE: "done",
        EXIT_FAILED: "failed: any error without a code below, a check that did not hold, or stopped by Ctrl-C or a no",
        EXIT_USAGE: "wrong usage: an unknown option, a missing argument, a value that cannot be, nothing to ask at",
        EXIT_NOT_FOUND: "not found, or no longer there",
        EXIT_REFUSED: "refused: not permitted, wrong passphrase, expired card or roster, or a contract said no",
        EXIT_NOT_FINAL: "not final in time",
    }
)

WRONG_OPTIONS = frozenset(
    {
        "USAGE_INVALID",
        "SENSOR_UNKNOWN",
        "PURPOSE_UNKNOWN",
        "FAULT_UNKNOWN",
        "FAULT_INVALID",
        "SPAN_INVALID",
        "NAME_TOO_SHORT",
        "NAME_AMBIGUOUS",
        "HANDLE_MISTYPED",
        "SERIAL_INVALID",
        "WORDS_REPEATED",
        "CONTRACT_ARGUMENTS_INVALID",
    }
)
"""Errors that say nothing but that an option or argument was written wrongly: no file, network or key could mend it."""

_BY_STATUS: Mapping[int, int] = MappingProxyType(
    {401: EXIT_REFUSED, 403: EXIT_REFUSED, 404: EXIT_NOT_FOUND, 410: EXIT_NOT_FOUND, 504: EXIT_NOT_FINAL}
)


def exit_code_of(entry: ErrorEntry) -> int:
    """Return the exit code by HTTP status, except usage errors and `..._REFUSED`."""
    if entry.code in WRONG_OPTIONS:
        return EXIT_USAGE
    return EXIT_REFUSED if entry.code.endswith("_REFUSED") else _BY_STATUS.get(entry.status, EXIT_FAILED)

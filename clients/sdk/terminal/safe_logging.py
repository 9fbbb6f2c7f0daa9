"""Command logs on standard error, with foreign control characters escaped."""

from __future__ import annotations

import sys
from typing import Any

import structlog

from consensus.visible_text import escape_controls

_ALLOWED = "\n\t"
_OF_FAULTS = frozenset({"exc_info", "stack_info"})


def escape_values(_logger: Any, _method: str, event: structlog.typing.EventDict) -> structlog.typing.EventDict:
    """Escape a log line (structlog processor)."""
    return {
        escape_controls(name, ""): value if name in _OF_FAULTS else _escaped(value) for name, value in event.items()
    }


def show_log_lines_safely() -> None:
    *first, renderer = structlog.get_config()["processors"]
    if escape_values not in first:
        structlog.configure(
            processors=[*first, escape_values, renderer], logger_factory=lambda *_: structlog.PrintLogger(sys.stderr)
        )


def _escaped(value: Any) -> Any:
    if isinstance(value, str):
        return escape_controls(value, _ALLOWED)
    return value if isinstance(value, int | float | bool | None) else escape_controls(repr(value), _ALLOWED)

"""Typed fields of page requests."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import EXACT_INTEGER_END

TEXT_MAX_CHARS = 1_024
IDS_MAX_COUNT = 25_000
"""More than a month of a person holds; all of them fit into a request (`pages.local_page.REQUEST_MAX_BYTES`)."""


def _refuse(detail: str) -> BlockRobotError:
    return BlockRobotError("REQUEST_INVALID", detail)


class RequestFields:
    """Fields of a body or query; `end` rejects unread ones."""

    def __init__(self, fields: Mapping[str, Any]) -> None:
        self._fields = dict(fields)

    def has(self, name: str) -> bool:
        """Whether a field is there and not empty."""
        return self._fields.get(name) not in (None, "", [])

    def text(self, name: str, default: str | None = None, *, max_chars: int = TEXT_MAX_CHARS) -> str:
        """Raises REQUEST_INVALID if missing without `default`."""
        value = self._fields.pop(name, None)
        if value is None:
            value = default
        if not isinstance(value, str) or len(value) > max_chars:
            raise _refuse(f"{name} is missing, or no text of at most {max_chars} characters.")
        return value

    def number(self, name: str, default: int | None = None, *, least: int = 0, most: int = EXACT_INTEGER_END) -> int:
        value = self._fields.pop(name, None)
        if value is None or value == "":
            value = default
        if isinstance(value, str) and value.isascii() and value.isdigit() and len(value) <= 16:
            value = int(value)
        if not isinstance(value, int) or isinstance(value, bool) or not least <= value <= most:
            raise _refuse(f"{name} is missing, or no whole number from {least} to {most}.")
        return value

    def flag(self, name: str, default: bool) -> bool:
        """Queries use 1 and 0."""
        value = self._fields.pop(name, default)
        if isinstance(value, str):
            value = {"1": True, "0": False, "true": True, "false": False}.get(value)
        if not isinstance(value, bool):
            raise _refuse(f"{name} is neither true nor false.")
        return value

    def texts(self, name: str) -> list[str]:
        value = self._fields.pop(name, None) or []
        if (
            not isinstance(value, list)
            or len(value) > IDS_MAX_COUNT
            or not all(isinstance(each, str) for each in value)
        ):
            raise _refuse(f"{name} is no list of texts.")
        return list(dict.fromkeys(value))

    def numbers(self, name: str) -> list[int]:
        """Sorted, non-negative; rejects an empty list, since absence means all."""
        if name not in self._fields:
            return []
        value = self._fields.pop(name)
        if not isinstance(value, list) or not 0 < len(value) <= IDS_MAX_COUNT:
            raise _refuse(f"{name} is no list of numbers.")
        if not all(type(each) is int and 0 <= each < EXACT_INTEGER_END for each in value):
            raise _refuse(f"{name} is no list of numbers.")
        return sorted(set(value))

    def ids(self, name: str) -> list[bytes]:
        return [read_id(text) for text in self.texts(name)]

    def end(self) -> None:
        if self._fields:
            raise _refuse(f"Nothing is known of {', '.join(sorted(self._fields))[:200]}.")


def read_id(text: str) -> bytes:
    """Read a hexadecimal id. Raises REQUEST_INVALID."""
    try:
        return bytes.fromhex(text)
    except ValueError:
        raise _refuse("An id is written in hexadecimal digits.") from None

"""Reading of untrusted JSON and TOML, with bounded nesting and keys."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from typing import Any, TypeVar

import msgspec

JSON_MAX_BYTES = 64 * 1024 * 1024
TOML_MAX_BYTES = 256 * 1024
NESTED_MAX_DEPTH = 64
LINE_DOTS_MAX_COUNT = 500
"""A key stands on one line; what else stands there counts too, and may go on in another line."""
T = TypeVar("T")


class TextInvalidError(ValueError):
    """A text is not of the expected form; the message may quote it."""


def read_json_text(
    text: str | bytes, max_bytes: int = JSON_MAX_BYTES, *, parse_float: Callable[[str], Any] | None = None
) -> Any:
    """Raises TextInvalidError."""
    _require_size(text, max_bytes)
    try:
        decoded = _decoded(text)
        value = json.loads(decoded, parse_float=parse_float)
        if "\\ud" in decoded.lower():
            json.dumps(value, ensure_ascii=False).encode("utf-8")  # half a surrogate pair is no character
    except RecursionError:
        raise _too_deep() from None
    except ValueError as error:
        raise TextInvalidError(str(error)) from None
    _require_shallow(value)
    return value


def read_json_as(text: str | bytes, kind: type[T], max_bytes: int = JSON_MAX_BYTES) -> T:
    """Raises TextInvalidError."""
    _require_size(text, max_bytes)
    try:
        return msgspec.json.decode(text, type=kind)
    except RecursionError:
        raise _too_deep() from None
    except (msgspec.MsgspecError, ValueError) as error:
        raise TextInvalidError(str(error)) from None


def read_toml_text(text: str | bytes, max_bytes: int = TOML_MAX_BYTES) -> dict[str, Any]:
    """Raises TextInvalidError."""
    _require_size(text, max_bytes)
    whole = _decoded(text)
    if any(line.count(".") > LINE_DOTS_MAX_COUNT for line in whole.split("\n")):
        raise TextInvalidError(f"a line has more than {LINE_DOTS_MAX_COUNT} dots")
    try:
        tables = tomllib.loads(whole)
    except RecursionError:
        raise _too_deep() from None
    except ValueError as error:
        raise TextInvalidError(str(error)) from None
    _require_shallow(tables)
    return tables


def _require_size(text: str | bytes, max_bytes: int) -> None:
    if len(text) > max_bytes:
        raise TextInvalidError(f"it is larger than {max_bytes} bytes")


def _decoded(text: str | bytes) -> str:
    try:
        return text if isinstance(text, str) else text.decode("utf-8")
    except UnicodeDecodeError:
        raise TextInvalidError("it is not UTF-8") from None


def _require_shallow(value: Any) -> None:
    level, depth = [value], 0
    while level := [
        inner
        for outer in level
        if isinstance(outer, dict | list)
        for inner in (outer.values() if isinstance(outer, dict) else outer)
        if isinstance(inner, dict | list)
    ]:
        depth += 1
        if depth >= NESTED_MAX_DEPTH:
            raise _too_deep()


def _too_deep() -> TextInvalidError:
    return TextInvalidError("it is nested too deeply")

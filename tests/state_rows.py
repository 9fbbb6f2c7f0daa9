"""Rows of the state for tests that care for a few fields of one: the others are empty."""

from __future__ import annotations

from typing import Any, Literal, get_args, get_origin, get_type_hints

from consensus.primitives.encoding import encode_value


def row_of(kind: type[Any], **fields: Any) -> dict[str, Any]:
    """Return what a contract stores for a row of this kind, as a decoded value. Fields that may be missing are."""
    needed = kind.__struct_fields__[: len(kind.__struct_fields__) - len(kind.__struct_defaults__)]
    hints = get_type_hints(kind)
    return {name: _empty(hints[name]) for name in needed} | fields


def stored(kind: type[Any], **fields: Any) -> bytes:
    """Return the encoded value of such a row."""
    return encode_value(row_of(kind, **fields))


def _empty(hint: Any) -> Any:
    if get_origin(hint) is Literal:
        return get_args(hint)[0]
    made = get_origin(hint) or hint
    return made() if made in {bytes, str, int, bool, list, dict} else None

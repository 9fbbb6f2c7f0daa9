"""Checks that decoding work is bounded by a message's bytes.

Untrusted definitions may contain zero-byte arrays or huge fixed arrays.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from rosbags.interfaces import Nodetype

BYTELESS_MAX_COUNT = 64
"""How many values without bytes, such as std_msgs/Empty, one value of a type may hold."""

WRITTEN_OUT_MAX_COUNT = 4_096
"""How many values the fixed arrays of a type and of those in it may have, numbers aside, which are read at once."""

_FILLER = "structure_needs_at_least_one_member"
"""The field of a type that has none: a byte in CDR, nothing in ROS 1."""


class _UnboundedError(Exception):
    pass


def is_bounded(type_name: str, fields: Mapping[str, Any], *, ros1: bool) -> bool:
    """Return whether decoding work is bounded; unknown types count as bounded."""
    try:
        walk = _Walk(fields, ros1=ros1)
        walk.look_at(type_name)
    except (_UnboundedError, RecursionError):
        return False
    return walk.written_out_count <= WRITTEN_OUT_MAX_COUNT


class _Walk:
    def __init__(self, fields: Mapping[str, Any], *, ros1: bool) -> None:
        self.written_out_count = 0
        self._fields = fields
        self._ros1 = ros1
        self._byteless: dict[str, bool] = {}
        self._counts: dict[str, int] = {}
        self._above: set[str] = set()
        self._later: list[str] = []

    def look_at(self, type_name: str) -> None:
        """Raise `_UnboundedError` or RecursionError for unbounded types."""
        self._later.append(type_name)
        while self._later:
            self._count(self._later.pop())

    def _count(self, name: str) -> int:
        """Zero-byte values in a value, itself included."""
        if name in self._above:
            raise _UnboundedError  # each value holds another of its kind
        if name not in self._counts:
            self._above.add(name)
            fields = self._fields[name][1] if name in self._fields else ()
            count = sum(self._count_in(kind, what) for _, (kind, what) in fields) + self._is_byteless(name)
            self._above.remove(name)
            if count > BYTELESS_MAX_COUNT:
                raise _UnboundedError
            self._counts[name] = count
        return self._counts[name]

    def _count_in(self, kind: Nodetype, what: Any) -> int:
        if kind is Nodetype.BASE:
            return 0
        if kind is Nodetype.NAME:
            return self._count(str(what))
        (inner, inner_what), length = what
        is_named = inner is Nodetype.NAME
        if is_named and self._is_byteless(str(inner_what)):
            raise _UnboundedError
        if kind is Nodetype.SEQUENCE:
            self._later += [str(inner_what)] if is_named else []
            return 0
        is_number = inner is Nodetype.BASE and inner_what[0] != "string"
        self.written_out_count += 0 if is_number else length
        return self._count(str(inner_what)) * length if is_named else 0

    def _is_byteless(self, name: str) -> bool:
        if name not in self._byteless:
            self._byteless[name] = False  # until it is known: of one that holds itself
            fields = self._fields[name][1] if name in self._fields else [("", (Nodetype.SEQUENCE, None))]
            self._byteless[name] = all(self._is_field_byteless(field, kind, what) for field, (kind, what) in fields)
        return self._byteless[name]

    def _is_field_byteless(self, field: str, kind: Nodetype, what: Any) -> bool:
        if kind is Nodetype.BASE:
            return self._ros1 and field == _FILLER
        if kind is Nodetype.NAME:
            return self._is_byteless(str(what))
        if kind is Nodetype.SEQUENCE:
            return False
        (inner, inner_what), length = what
        return length == 0 or (inner is Nodetype.NAME and self._is_byteless(str(inner_what)))

"""State keys and rows: building, parsing and encoding.

A flat key is contract name, zero byte and own key; missing or mistyped fields raise ENCODING_INVALID.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any, Generic, Protocol, TypeVar

import msgspec

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode_value, encode_value

KEY_BYTES = 33
HASH_BYTES = 32
RECORD_ID_BYTES = 16
U32_BYTES = 4
U64_BYTES = 8
TEXT = 0
"""A part of a key that is text without a slash, of any length. The other parts are sizes in bytes."""

T = TypeVar("T")
Values = Mapping[bytes, Any]
"""Decoded values by flat key, as proofs have them: None for what is proved absent, nothing for what was not asked for."""
Form = tuple[int | bytes, ...]
"""The parts of a key after its prefix: sizes, `TEXT`, and bytes that are always the same, such as a slash."""
ALL_ROWS_COUNT = 1 << 60


class Reader(Protocol):
    """Reads the encoded value under a flat key."""

    def get(self, key: bytes, /) -> bytes | None: ...


class Scanner(Protocol):
    """Scans values under a key prefix."""

    def scan(self, prefix: bytes, limit: int, /) -> Iterator[tuple[bytes, bytes]]:
        """Yield up to `limit` (flat key, encoded value) pairs in key order."""
        ...


class RangeScanner(Protocol):
    """Scans values of a range of keys."""

    def scan_range(self, start: bytes, end: bytes, /) -> Iterator[tuple[bytes, bytes]]:
        """Yield (flat key, encoded value) pairs in [start, end), in key order."""
        ...


class UnreadError(KeyError):
    """A query needs an unrequested key: its one argument."""


class DecodedReader:
    """Reads proven decoded values; an unrequested key is never taken as absent."""

    def __init__(self, values: Values) -> None:
        self._values = values

    def get(self, key: bytes, /) -> bytes | None:
        if key not in self._values:
            raise UnreadError(key)
        value = self._values[key]
        return None if value is None else encode_value(value)


class Row(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Base of map rows; fields with a default may be missing, a `time` is in ms."""


class ListRow(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """Base of list rows in field order; trailing defaults may be missing, a `time` is in ms."""


def try_convert(value: Any, kind: type[T]) -> T | None:
    """Convert a decoded value, ignoring later versions' fields of a row; return None if it has another form."""
    try:
        return _convert(value, kind)
    except msgspec.ValidationError:
        return None


def _convert(value: Any, kind: type[T]) -> T:
    if isinstance(value, dict) and isinstance(kind, type) and issubclass(kind, Row):
        value = {name: value[name] for name in kind.__struct_fields__ if name in value}
    # Without `builtin_types` a text would pass for base64 of bytes.
    found: T = msgspec.convert(value, kind, builtin_types=(bytes,))
    return found


class Rows(Generic[T]):
    """One kind of a contract's rows: reading, writing and key matching."""

    def __init__(self, contract: str, name: str, form: Form, kind: Any) -> None:
        self.name = f"{contract} {name}"
        self.flat = flat_prefix(contract) + name.encode()
        self.form = form
        self.kind = kind
        self._decoder: msgspec.msgpack.Decoder[T] = msgspec.msgpack.Decoder(kind)
        self._pattern = re.compile(re.escape(self.flat) + b"".join(map(_pattern_of, form)), re.DOTALL)

    def owns(self, key: bytes) -> bool:
        return self._pattern.fullmatch(key) is not None

    def decode(self, data: bytes) -> T:
        """Decode a row with exactly its fields. Raises ENCODING_INVALID."""
        try:
            return self._decoder.decode(data)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            raise self._invalid(error) from None

    def convert(self, value: Any) -> T:
        """Convert a decoded value, ignoring later versions' fields. Raises ENCODING_INVALID."""
        try:
            row: T = _convert(value, self.kind)
        except msgspec.ValidationError as error:
            raise self._invalid(error) from None
        return row

    def encode(self, row: T) -> bytes:
        return encode_value(to_value(row))

    def _among(self, values: Values, key: bytes) -> T | None:
        value = values[key]
        return None if value is None else self.convert(value)

    def _from(self, data: bytes) -> T:
        try:
            return self._decoder.decode(data)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            return self.convert(decode_value(data))

    def _invalid(self, error: Exception) -> BlockRobotError:
        return BlockRobotError("ENCODING_INVALID", f"What stands under {self.name} is no such row: {error}.")


class StateKey(Rows[T]):
    """One contract key, and how its value is read."""

    def __init__(self, contract: str, name: str, kind: Any) -> None:
        super().__init__(contract, name, (), kind)

    def read(self, state: Reader) -> T | None:
        """Return the value or None. Raises ENCODING_INVALID."""
        data = state.get(self.flat)
        return None if data is None else self._from(data)

    def among(self, values: Values) -> T | None:
        """Return the value among decoded ones. Raises KeyError if unrequested."""
        return self._among(values, self.flat)


class Prefix(Rows[T]):
    """A contract's keys of one prefix, and their rows."""

    def __init__(self, contract: str, name: str, form: Form, kind: Any) -> None:
        super().__init__(contract, name, form, kind)
        self._has_one_part = len(form) == 1

    def key(self, *parts: bytes | str | int) -> bytes:
        """Return a flat key: bytes and text as they are, numbers big-endian."""
        if self._has_one_part and type(parts[0]) is bytes:
            return self.flat + parts[0]
        left = iter(parts)
        key = self.flat
        for size in self.form:
            key += size if isinstance(size, bytes) else _encode_part(size, next(left))
        return key

    def start(self, first: bytes) -> bytes:
        return self.flat + first

    def split(self, key: bytes) -> tuple[bytes, ...]:
        """Return a flat key's parts. Raises ENCODING_INVALID."""
        found = self._pattern.fullmatch(key)
        if found is None:
            raise BlockRobotError("ENCODING_INVALID", f"{key.hex()} is no key of {self.name}.")
        return found.groups()

    def at(self, state: Reader, *parts: bytes | str | int) -> T | None:
        """Return the row under these parts, or None. Raises ENCODING_INVALID."""
        # Not by `key`: each call about a sender asks a few of these, and most have nothing.
        data = state.get(self.flat + parts[0] if self._has_one_part and type(parts[0]) is bytes else self.key(*parts))
        return None if data is None else self._from(data)

    def among(self, values: Values, *parts: bytes | str | int) -> T | None:
        """Return the row among decoded values. Raises KeyError if unrequested."""
        return self._among(values, self.key(*parts))

    def has(self, state: Reader, *parts: bytes | str | int) -> bool:
        return state.get(self.key(*parts)) is not None

    def rows(
        self, state: Scanner, first: bytes = b"", limit: int = ALL_ROWS_COUNT
    ) -> Iterator[tuple[tuple[bytes, ...], T]]:
        """Yield key parts and rows in key order. Raises ENCODING_INVALID."""
        for key, data in state.scan(self.start(first), limit):
            yield self.split(key), self._from(data)

    def rows_after(self, state: RangeScanner, last: bytes) -> Iterator[tuple[tuple[bytes, ...], T]]:
        """As `rows`, those behind the key that ends with `last`; all, if that is empty."""
        first = self.start(last) + b"\x00" if last else self.flat
        beyond = self.flat[:-1] + bytes((self.flat[-1] + 1,))
        for key, data in state.scan_range(first, beyond):
            yield self.split(key), self._from(data)


def flat_prefix(contract: str) -> bytes:
    return contract.encode() + b"\x00"


def to_value(row: Any) -> Any:
    value = msgspec.msgpack.decode(msgspec.msgpack.encode(row))
    if isinstance(row, Row):
        for name, default in zip(reversed(row.__struct_fields__), reversed(row.__struct_defaults__), strict=False):
            if value[name] == default:
                del value[name]
    elif isinstance(row, ListRow):
        for default in reversed(row.__struct_defaults__):
            if value[-1] != default:
                break
            value.pop()
    return value


def _pattern_of(size: int | bytes) -> bytes:
    if isinstance(size, bytes):
        return re.escape(size)
    return rb"([^/]+)" if size == TEXT else b"(.{%d})" % size


def _encode_part(size: int, part: bytes | str | int) -> bytes:
    if isinstance(part, int):
        return part.to_bytes(size, "big")
    return part.encode() if isinstance(part, str) else part

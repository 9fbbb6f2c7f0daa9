"""Canonical MessagePack: one byte string per value, anything else rejected.

Structs are `Wire` arrays in field order; values None, bool, int below 2^256 in magnitude, str, bytes, list, dict.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, TypeVar

import msgspec

from consensus.errors import BlockRobotError

EXACT_INTEGER_END = 1 << 53
"""Every program that reads JSON knows the whole numbers below exactly."""
VALUE_DEPTH_MAX = 16
VALUE_INT_BITS_MAX = 256
_DICT_KEY_BITS_MAX = 60
_BIG_INT_EXTENSION = 1
_CACHED_KEYS_MAX_COUNT = 32
_FLAT_KINDS = frozenset((bytes, str, int, bool, type(None)))

W = TypeVar("W", bound="Wire")


class Wire(msgspec.Struct, array_like=True, frozen=True, forbid_unknown_fields=True, gc=False):
    """Base of protocol messages: an immutable array in field order."""


_encoder = msgspec.msgpack.Encoder()
_encode = _encoder.encode
_decoders: dict[Any, msgspec.msgpack.Decoder[Any]] = {}


def encode(message: Wire) -> bytes:
    return _encoder.encode(message)


def decode(data: bytes, kind: type[W]) -> W:
    """Decode a canonical struct. Raises ENCODING_INVALID, or ENCODING_NOT_CANONICAL for another form."""
    decoder = _decoders.get(kind)
    if decoder is None:
        decoder = _decoders[kind] = msgspec.msgpack.Decoder(kind)
    try:
        message: W = decoder.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise BlockRobotError("ENCODING_INVALID", f"These bytes are not a {kind.__name__}: {error}.") from None
    if _encoder.encode(message) != data:
        raise BlockRobotError("ENCODING_NOT_CANONICAL", f"These bytes are not the canonical form of a {kind.__name__}.")
    return message


def _prepare_int(value: int) -> Any:
    if -(1 << 63) <= value < (1 << 64):
        return value
    if value.bit_length() > VALUE_INT_BITS_MAX:
        raise BlockRobotError("VALUE_INVALID", "An integer is larger than 256 bits.")
    size = (value.bit_length() + 8) // 8 if value >= 0 else ((value + 1).bit_length() + 8) // 8
    return msgspec.msgpack.Ext(_BIG_INT_EXTENSION, value.to_bytes(size, "big", signed=True))


def _prepare_dict(value: dict[Any, Any], depth: int) -> Any:
    for key in value:
        if type(key) is int:
            if key.bit_length() > _DICT_KEY_BITS_MAX:
                raise BlockRobotError("VALUE_INVALID", "A dict key is an integer of more than 60 bits.")
        elif type(key) is not str and type(key) is not bytes:
            raise BlockRobotError("VALUE_INVALID", f"A dict key is of type {type(key).__name__}.")
    ordered = sort_keys(tuple(value)) if len(value) <= _CACHED_KEYS_MAX_COUNT else sorted(value, key=_encoder.encode)
    result: dict[Any, Any] = {}
    for key in ordered:
        item = value[key]
        result[key] = item if type(item) is bytes or type(item) is str else _prepare(item, depth + 1)
    return result


@lru_cache(maxsize=256)
def sort_keys(keys: tuple[Any, ...]) -> tuple[Any, ...]:
    return tuple(sorted(keys, key=_encoder.encode))


def _prepare(value: Any, depth: int) -> Any:
    kind = type(value)
    if kind is bytes or kind is str or value is None or kind is bool:
        return value
    if kind is int:
        return _prepare_int(value)
    if depth >= VALUE_DEPTH_MAX:
        raise BlockRobotError("VALUE_INVALID", f"A value is nested deeper than {VALUE_DEPTH_MAX} levels.")
    if kind is list or kind is tuple:
        return [_prepare(item, depth + 1) for item in value]
    if kind is dict:
        return _prepare_dict(value, depth)
    raise BlockRobotError("VALUE_INVALID", f"A value of type {kind.__name__} cannot be stored.")


def encode_value(value: Any) -> bytes:
    """Return a value's canonical bytes. Raises VALUE_INVALID.

    Dicts are sorted by encoded key; integers beyond 64 bits are extension 1, minimal two's complement.
    """
    try:
        return _encoder.encode(_prepare(value, 0))
    except UnicodeEncodeError:
        raise BlockRobotError("VALUE_INVALID", "A text holds a lone surrogate.") from None


def encode_ordered(value: Any) -> bytes | None:
    """Encode a checked scalar, or a flat dict or list with ordered keys; None for large integers."""
    try:
        return _encode(value)
    except (OverflowError, UnicodeEncodeError):
        return None


def encoder_of_dicts(keys: tuple[Any, ...]) -> Callable[[tuple[Any, ...]], bytes | None]:
    """Return an `encode_ordered` for dicts with these ordered keys, taking their items."""
    count = len(keys)
    if not count:
        return lambda _: _encode({})
    prepared: list[Any] = [None] * (2 * count)
    header = _encode(dict.fromkeys(range(count)))[: -2 * count]
    skipped = len(_encode(prepared)) - 2 * count
    prepared[::2] = [msgspec.Raw(_encode(key)) for key in keys]
    prepared[0] = msgspec.Raw(header + _encode(keys[0]))

    def encode_items(items: tuple[Any, ...]) -> bytes | None:
        parts = prepared.copy()
        parts[1::2] = items
        try:
            return _encode(parts)[skipped:]
        except (OverflowError, UnicodeEncodeError):
            return None

    return encode_items


def _is_flat(value: Any) -> bool:
    return type(value) in _FLAT_KINDS or (type(value) is list and _FLAT_KINDS.issuperset(map(type, value)))


def _encode_decoded(value: Any) -> bytes:
    data = encode_ordered(value) if _is_flat(value) else None
    return encode_value(value) if data is None else data


def _read_extension(code: int, data: memoryview) -> int:
    if code != _BIG_INT_EXTENSION:
        raise BlockRobotError("ENCODING_INVALID", f"Extension type {code} is unknown.")
    return int.from_bytes(bytes(data), "big", signed=True)


_value_decoder = msgspec.msgpack.Decoder(ext_hook=_read_extension)


def decode_value(data: bytes) -> Any:
    """Decode a canonical value. Raises ENCODING_* as `decode`."""
    try:
        value = _value_decoder.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError, TypeError) as error:
        raise BlockRobotError("ENCODING_INVALID", f"These bytes are not a value: {error}.") from None
    try:
        again = _encode_decoded(value)
    except BlockRobotError as error:
        raise BlockRobotError("ENCODING_INVALID", error.detail) from None
    if again != data:
        raise BlockRobotError("ENCODING_NOT_CANONICAL", "These bytes are not the canonical form of a value.")
    return value


def decode_stored_value(data: bytes) -> Any:
    """Decode trusted bytes of one's own `encode_value` without checking form."""
    return _value_decoder.decode(data)


def u32(number: int) -> bytes:
    """Return `number` as 4 bytes, big-endian."""
    return number.to_bytes(4, "big")


def u64(number: int) -> bytes:
    """Return `number` as 8 bytes, big-endian."""
    return number.to_bytes(8, "big")

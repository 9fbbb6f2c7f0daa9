"""The contract value types and their checks; no other type gets in.

Border values (state, events, arguments, results) are walked and charged before copying or encoding: shared or cyclic
structures cannot exceed the charge.
"""

from __future__ import annotations

from typing import Any

from consensus.primitives.encoding import VALUE_DEPTH_MAX, decode_stored_value, encode_ordered, encode_value
from contracts.vm.model.dict_shapes import WALKED_DICT_GAS, WALKED_ENTRY_GAS, WALKED_LIST_GAS, encode_by_shape
from contracts.vm.model.faults import INT_OVERFLOW, TYPE_ERROR, VALUE_ERROR, Fault
from contracts.vm.model.meter import ALLOCATION_GAS, ALLOCATION_SHIFT, Runtime

INT_LIMIT = 1 << 256
INT_FLOOR = -INT_LIMIT
"""Integers lie between these two, and are neither."""
DICT_KEY_INT_LIMIT = 1 << 60
DICT_KEY_MAX_CHARS = 1024
FREE_INT_KEYS_MAX_COUNT = 256
INT_KEY_SHIFT = 6
"""A search for an int in a dict of more entries than that costs one unit more for each 64 (2 to this power) of them."""
ITEM_BYTES = 24
"""Of a list or tuple: the reference, and most of what an int of 256 bits takes, which no operation charges by itself."""
HEADER_BYTES = 64
BIG_INT_GAS = 8
DICT_ENTRY_BYTES = 128

NoneType = type(None)
_IMMUTABLE = frozenset((bytes, str, int, bool, NoneType))

_KEPT_MIN_BYTES = 12
_KEPT_MAX_BYTES = 512
_KEPT_ITEMS_MAX_COUNT = 64
_KEPT_MAX_COUNT = 1024
_decoded: dict[bytes, tuple[Any, int, int]] = {}
"""Stored bytes -> (the value, or MISSING if it is not flat; its modelled size). A memory of this process, no state."""


class Mark:
    """An interpreter sentinel that never reaches a contract."""

    __slots__ = ("name",)

    def __init__(self, name: str) -> None:
        self.name = name


UNSET: Any = Mark("unset")
MISSING: Any = Mark("missing")


def type_name(value: Any) -> str:
    return "None" if value is None else type(value).__name__


def type_fault(what: str, *values: Any) -> Fault:
    return Fault(TYPE_ERROR, f"{what} does not take {' and '.join(type_name(value) for value in values)}.")


def check_int(number: int) -> int:
    """Check for 256 bits. Raises INT_OVERFLOW."""
    if INT_FLOOR < number < INT_LIMIT:
        return number
    raise Fault(INT_OVERFLOW, "An integer grew beyond 256 bits.")


def need_int(value: Any, what: str) -> int:
    """Raises TYPE_ERROR unless it is an int; a bool is none."""
    if type(value) is int:
        return value
    raise type_fault(what, value)


def need_str(value: Any, what: str) -> str:
    """Raises TYPE_ERROR unless it is a str."""
    if type(value) is str:
        return value
    raise type_fault(what, value)


def need_bytes(value: Any, what: str) -> bytes:
    """Raises TYPE_ERROR unless it is bytes."""
    if type(value) is bytes:
        return value
    raise type_fault(what, value)


def check_dict_key(key: Any) -> None:
    """Allow only ints up to 60 bits and quickly compared str and bytes."""
    kind = type(key)
    if kind is str or kind is bytes:
        if len(key) <= DICT_KEY_MAX_CHARS:
            return
        raise Fault(VALUE_ERROR, f"A key of a dict has at most {DICT_KEY_MAX_CHARS} characters or bytes.")
    if kind is int:
        if -DICT_KEY_INT_LIMIT < key < DICT_KEY_INT_LIMIT:
            return
        raise Fault(VALUE_ERROR, "An integer key of a dict has at most 60 bits.")
    raise Fault(TYPE_ERROR, f"A dict key is str, bytes or int, not {type_name(key)}.")


def charge_key(runtime: Runtime, entries: dict[Any, Any], key: Any) -> None:
    """Check a dict key; charge the search for an int among many.

    Python hashes ints by low bits, so chosen keys can all collide.
    """
    check_dict_key(key)
    if type(key) is int and len(entries) > FREE_INT_KEYS_MAX_COUNT:
        runtime.charge(len(entries) >> INT_KEY_SHIFT)


def charge_int_keys(runtime: Runtime, entries: dict[Any, Any], more: int = 0) -> None:
    """Among themselves and with `more` others."""
    count = len(entries) + more
    if count > FREE_INT_KEYS_MAX_COUNT:
        runtime.charge(sum(type(key) is int for key in entries) * (count >> INT_KEY_SHIFT))


def unit_bytes(*texts: str) -> int:
    """Return the modelled size per character: Python uses 1, 2 or 4."""
    return 1 if all(map(str.isascii, texts)) else 4


def text_bytes(text: str) -> int:
    return HEADER_BYTES + (len(text) if text.isascii() else 4 * len(text))


def charge_decoded(runtime: Runtime, value: Any) -> None:
    size, gas = _measure(value)
    runtime.memory -= size
    runtime.charge(gas)
    runtime.allocate(0)


def _measure(root: Any) -> tuple[int, int]:
    kind = type(root)
    if kind is bytes or kind is str:
        size = HEADER_BYTES + len(root) if kind is bytes else text_bytes(root)
        return size, size >> 8
    if kind is not dict and kind is not list:
        return 0, 0
    size = gas = 0
    pending = [root]
    while pending:
        container = pending.pop()
        if type(container) is dict:
            count = len(container)
            size += HEADER_BYTES + DICT_ENTRY_BYTES * count
            gas += 2 + 3 * count
            if count > FREE_INT_KEYS_MAX_COUNT:
                gas += sum(type(key) is int for key in container) * (count >> INT_KEY_SHIFT)
            items: Any = container.values()
        else:
            size += HEADER_BYTES + ITEM_BYTES * len(container)
            gas += 2 + len(container)
            items = container
        for item in items:
            kind = type(item)
            if kind is bytes:
                size += HEADER_BYTES + len(item)
            elif kind is str:
                size += text_bytes(item)
            elif kind is dict or kind is list:
                pending.append(item)
            elif kind is int and not -(1 << 63) <= item < 1 << 64:
                gas += BIG_INT_GAS
    return size, gas + (size >> 8)


def read_stored(runtime: Runtime, data: bytes) -> Any:
    """Decode stored bytes under charge; frequent values are cached, readers get copies."""
    known = _decoded.get(data)
    value, size, gas = _decode(data) if known is None else known
    runtime.memory -= size
    runtime.gas -= gas
    if runtime.memory < 0 or runtime.gas < 0:
        runtime.exhausted()
    if known is None:
        return value
    if value is MISSING:
        return decode_stored_value(data)
    return value.copy() if type(value) is dict or type(value) is list else value


def _decode(data: bytes) -> tuple[Any, int, int]:
    value = decode_stored_value(data)
    size, gas = _measure(value)
    if _KEPT_MIN_BYTES <= len(data) <= _KEPT_MAX_BYTES:
        if len(_decoded) >= _KEPT_MAX_COUNT:
            _decoded.clear()
        _decoded[data] = _template(value), size, gas
    return value, size, gas


def _template(value: Any) -> Any:
    if type(value) is not dict and type(value) is not list:
        return value
    flat = _IMMUTABLE.issuperset(map(type, value.values() if type(value) is dict else value))
    return value.copy() if flat and len(value) <= _KEPT_ITEMS_MAX_COUNT else MISSING


def encode_checked(runtime: Runtime, value: Any, size_max: int, what: str) -> bytes:
    """Walk a value under charge, then encode it. Raises VALUE_ERROR beyond `size_max`."""
    kind = type(value)
    if kind is dict:
        return encode_by_shape(runtime, value, size_max) or encode_walked(runtime, value, size_max, what)
    if kind is int or kind is bool:
        return encode_ordered(value) or encode_value(value)
    return encode_walked(runtime, value, size_max, what)


def encode_walked(runtime: Runtime, value: Any, size_max: int, what: str) -> bytes:
    _walk(runtime, value, 0, size_max, what)
    data = encode_value(value)
    if len(data) > size_max:
        raise _too_large(what)
    return data


def _too_large(what: str) -> Fault:
    return Fault(VALUE_ERROR, f"{what} is too large.")


def _walk(runtime: Runtime, value: Any, depth: int, left: int, what: str) -> int:
    kind = type(value)
    left -= 1 + len(value) if kind is bytes or kind is str else 1
    if kind in _IMMUTABLE:
        pass
    elif depth >= VALUE_DEPTH_MAX:
        raise Fault(VALUE_ERROR, f"{what} is nested deeper than {VALUE_DEPTH_MAX} levels.")
    elif kind is dict:
        runtime.charge(WALKED_DICT_GAS + WALKED_ENTRY_GAS * len(value))
        charge_int_keys(runtime, value)
        left -= 2 * len(value)
        for key, item in value.items():
            left -= 0 if type(key) is int else len(key)
            inner = type(item)
            if inner is bytes or inner is str:
                left -= len(item)
            elif inner is not int:
                left = _walk(runtime, item, depth + 1, left + 1, what)
    elif kind is list or kind is tuple:
        runtime.charge(WALKED_LIST_GAS + 3 * len(value))
        for item in value:
            left = _walk(runtime, item, depth + 1, left, what)
    else:
        raise Fault(TYPE_ERROR, f"{what} cannot hold a {type_name(value)}; make it a list.")
    if left < 0:
        raise _too_large(what)
    return left


def copy_across(runtime: Runtime, value: Any, what: str, depth: int = 0) -> Any:
    """Return a charged deep copy, tuples as lists, sharing nothing mutable.

    Shared contents are charged per occurrence.
    """
    kind = type(value)
    if kind is bytes:
        if depth:
            runtime.allocate(len(value))
        return value
    if value is None or kind is bool:
        return value
    if kind is int:
        return value if INT_FLOOR < value < INT_LIMIT else check_int(value)
    if kind is str:
        return _copy_text(runtime, value, what)
    if depth >= VALUE_DEPTH_MAX:
        raise Fault(VALUE_ERROR, f"{what} is nested deeper than {VALUE_DEPTH_MAX} levels.")
    if kind is list or kind is tuple:
        runtime.charge(2 + 2 * len(value))
        runtime.allocate(HEADER_BYTES + ITEM_BYTES * len(value))
        return [copy_across(runtime, item, what, depth + 1) for item in value]
    if kind is dict:
        runtime.gas -= 6 + 3 * len(value)
        runtime.allocate(HEADER_BYTES + DICT_ENTRY_BYTES * len(value))
        charge_int_keys(runtime, value)
        for key in value:
            check_dict_key(key)
        return {key: copy_across(runtime, item, what, depth + 1) for key, item in value.items()} if value else {}
    raise Fault(TYPE_ERROR, f"{what} cannot hold a {type_name(value)}; make it a list.")


def _copy_text(runtime: Runtime, text: str, what: str) -> str:
    is_ascii = text.isascii()
    size = HEADER_BYTES + (len(text) if is_ascii else 4 * len(text))
    runtime.memory -= size
    runtime.gas -= ALLOCATION_GAS + (size >> ALLOCATION_SHIFT)
    if runtime.memory < 0 or runtime.gas < 0:
        runtime.exhausted()
    if is_ascii:
        return text
    runtime.charge(2 + (len(text) >> 4))
    try:
        text.encode()
    except UnicodeEncodeError:
        raise Fault(VALUE_ERROR, f"{what} holds a lone surrogate.") from None
    return text


def count_items(root: Any) -> int:
    count = 0
    pending = [root]
    while pending:
        container = pending.pop()
        if type(container) is list or type(container) is dict:
            count += len(container)
            items = container.values() if type(container) is dict else container
            pending.extend([item for item in items if type(item) is list or type(item) is dict])
    return count


def fresh_constant(runtime: Runtime, value: Any) -> Any:
    """Copy a mutable module constant, isolating calls from each other."""
    kind = type(value)
    if kind is list:
        runtime.charge(4 + 2 * len(value))
        runtime.allocate(HEADER_BYTES + ITEM_BYTES * len(value))
        return [fresh_constant(runtime, item) for item in value]
    if kind is tuple:
        runtime.charge(4 + 2 * len(value))
        runtime.allocate(HEADER_BYTES + ITEM_BYTES * len(value))
        return tuple([fresh_constant(runtime, item) for item in value])
    if kind is dict:
        runtime.charge(4 + 3 * len(value))
        runtime.allocate(HEADER_BYTES + DICT_ENTRY_BYTES * len(value))
        charge_int_keys(runtime, value)
        return {key: fresh_constant(runtime, item) for key, item in value.items()}
    return value


def is_mutable(value: Any) -> bool:
    if type(value) is tuple:
        return any(is_mutable(item) for item in value)
    return type(value) in (list, dict)

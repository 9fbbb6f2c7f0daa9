"""Checked operators on contract values; cost is known before Python computes.

Each charges for its data and returns a value or raises `Fault`. A bool is no int, 1 == True is False, and nothing
converts implicitly.
"""
# ruff: noqa: ARG001 - one signature for all operators; a branch per type is the subject here

from __future__ import annotations

import operator
from collections.abc import Callable, Iterable
from typing import Any

from contracts.vm.model.faults import INDEX_ERROR, INT_OVERFLOW, KEY_ERROR, VALUE_ERROR, ZERO_DIVISION, Fault
from contracts.vm.model.meter import ALLOCATION_GAS, ALLOCATION_SHIFT, Runtime
from contracts.vm.model.values import (
    DICT_ENTRY_BYTES,
    HEADER_BYTES,
    INT_FLOOR,
    INT_LIMIT,
    ITEM_BYTES,
    MISSING,
    charge_int_keys,
    charge_key,
    check_int,
    need_int,
    type_fault,
    unit_bytes,
)

Operation = Callable[[Runtime, Any, Any], Any]

COMPARE_DEPTH_MAX = 30
FREE_COMPARE_MAX_BYTES = 127
COMPARE_SHIFT = 10
WIDE_EQUAL_SHIFT = 8
WIDE_COMPARE_SHIFT = 5
TEXT_GAS = 4
SLICE_GAS = 12
SEARCH_GAS = 6
DELETE_GAS = 3
ORDER_GAS = 3
KEYS_GAS = 3
SHIFT_SHIFT = 8
"""Items that may move as one is put in or taken out of a list cost one unit for each 256 (2 to this power)."""
RANGE_LIMIT = 1 << 60
SHIFT_MAX_BITS = 256
HOLES_MIN_BYTES = 512
HOLES_ENTRY_BYTES = 256


def add(runtime: Runtime, left: Any, right: Any) -> Any:
    """`left + right`: ints, or two of the same of str, bytes, list, tuple."""
    kind = type(left)
    if kind is type(right):
        if kind is int:
            total = left + right
            if INT_FLOOR < total < INT_LIMIT:
                return total
            return check_int(total)
        if kind is bytes:
            size = HEADER_BYTES + len(left) + len(right)
            runtime.memory -= size
            runtime.gas -= ALLOCATION_GAS + (size >> ALLOCATION_SHIFT)
            if runtime.memory < 0 or runtime.gas < 0:
                runtime.exhausted()
            return left + right
        if kind is str:
            runtime.charge(TEXT_GAS)
            runtime.allocate(HEADER_BYTES + unit_bytes(left, right) * (len(left) + len(right)))
            return left + right
        if kind is list or kind is tuple:
            runtime.charge((len(left) + len(right)) >> 6)
            runtime.allocate(HEADER_BYTES + ITEM_BYTES * (len(left) + len(right)))
            return left + right
    raise type_fault("'+'", left, right)


def _both_ints(sign: str, left: Any, right: Any) -> None:
    if type(left) is not int or type(right) is not int:
        raise type_fault(sign, left, right)


def subtract(runtime: Runtime, left: Any, right: Any) -> int:
    _both_ints("'-'", left, right)
    return check_int(left - right)


def multiply(runtime: Runtime, left: Any, right: Any) -> Any:
    if type(left) is int:
        if type(right) is int:
            return check_int(left * right)
        left, right = right, left
    kind = type(left)
    if type(right) is not int or kind not in (str, bytes, list, tuple):
        raise type_fault("'*'", left, right)
    count = max(right, 0)
    unit = ITEM_BYTES if kind is list or kind is tuple else 1
    if kind is str and not left.isascii():
        unit = 4
    runtime.charge(TEXT_GAS)
    runtime.allocate(HEADER_BYTES + len(left) * unit * count)
    return left * count if left else left[:]


def floor_divide(runtime: Runtime, left: Any, right: Any) -> int:
    _both_ints("'//'", left, right)
    if right == 0:
        raise Fault(ZERO_DIVISION, "The divisor is zero.")
    return check_int(left // right)


def modulo(runtime: Runtime, left: Any, right: Any) -> int:
    """`left % right` of ints, with the divisor's sign."""
    if type(left) is not int or type(right) is not int:
        raise type_fault("'%'", left, right)
    if right == 0:
        raise Fault(ZERO_DIVISION, "The divisor is zero.")
    result: int = left % right
    return result


def power(runtime: Runtime, left: Any, right: Any) -> int:
    """`left ** right` of ints; the exponent is not negative."""
    _both_ints("'**'", left, right)
    runtime.charge(8)
    if right < 0:
        raise Fault(VALUE_ERROR, "The exponent is negative.")
    if abs(left) > 1 and (right > SHIFT_MAX_BITS or (abs(left).bit_length() - 1) * right > SHIFT_MAX_BITS):
        raise Fault(INT_OVERFLOW, "An integer grew beyond 256 bits.")
    if abs(left) <= 1:
        right = right & 1 if left == -1 else min(right, 1)
    return check_int(left**right)


def shift_left(runtime: Runtime, left: Any, right: Any) -> int:
    _both_ints("'<<'", left, right)
    if right < 0:
        raise Fault(VALUE_ERROR, "The shift count is negative.")
    if left == 0:
        return 0
    if right > SHIFT_MAX_BITS:
        raise Fault(INT_OVERFLOW, "An integer grew beyond 256 bits.")
    return check_int(left << right)


def shift_right(runtime: Runtime, left: Any, right: Any) -> int:
    _both_ints("'>>'", left, right)
    if right < 0:
        raise Fault(VALUE_ERROR, "The shift count is negative.")
    result: int = left >> min(right, SHIFT_MAX_BITS + 1)
    return result


def _bitwise(sign: str, apply: Callable[[int, int], int]) -> Operation:
    def run(runtime: Runtime, left: Any, right: Any) -> int:
        _both_ints(sign, left, right)
        return check_int(apply(left, right))

    return run


def negate(runtime: Runtime, value: Any) -> int:
    return -need_int(value, "Unary '-'")


def plus(runtime: Runtime, value: Any) -> int:
    return need_int(value, "Unary '+'")


def invert(runtime: Runtime, value: Any) -> int:
    return check_int(~need_int(value, "'~'"))


def is_short_text(value: Any) -> bool:
    """Whether comparison costs nothing extra: at most 127 characters or bytes."""
    return (type(value) is str or type(value) is bytes) and len(value) <= FREE_COMPARE_MAX_BYTES


def compare_shift(left: Any, right: Any) -> int:
    """Return the power of two characters by which a comparison is charged.

    Non-ASCII texts of different memory widths may be compared letter by letter.
    """
    if type(left) is bytes or (left.isascii() and right.isascii()):
        return COMPARE_SHIFT
    return WIDE_COMPARE_SHIFT


def equal(runtime: Runtime, left: Any, right: Any) -> bool:
    """`left == right`; values of different types are never equal."""
    kind = type(left)
    if kind is not type(right):
        return False
    if kind is bytes or kind is str:
        if len(left) > FREE_COMPARE_MAX_BYTES and len(left) == len(right):
            runtime.charge(len(left) >> (COMPARE_SHIFT if kind is bytes or left.isascii() else WIDE_EQUAL_SHIFT))
        return bool(left == right)
    if kind is list or kind is tuple or kind is dict:
        return _equal_containers(runtime, left, right, 0)
    return bool(left == right)


def _equal_containers(runtime: Runtime, left: Any, right: Any, depth: int) -> bool:
    if depth >= COMPARE_DEPTH_MAX:
        raise Fault(VALUE_ERROR, f"Values nested deeper than {COMPARE_DEPTH_MAX} levels are not compared.")
    runtime.charge(6)
    if len(left) != len(right):
        return False
    if type(left) is dict:
        charge_int_keys(runtime, left)
        for key, item in left.items():
            if key not in right or not _equal_items(runtime, item, right[key], depth):
                return False
        return True
    return all(_equal_items(runtime, item, right[index], depth) for index, item in enumerate(left))


def _equal_items(runtime: Runtime, left: Any, right: Any, depth: int) -> bool:
    runtime.charge(4)
    kind = type(left)
    if kind is type(right) and kind in (list, tuple, dict):
        return _equal_containers(runtime, left, right, depth + 1)
    return equal(runtime, left, right)


def not_equal(runtime: Runtime, left: Any, right: Any) -> bool:
    return not equal(runtime, left, right)


def _order(sign: str, apply: Callable[[Any, Any], bool]) -> Operation:
    def run(runtime: Runtime, left: Any, right: Any) -> bool:
        kind = type(left)
        if kind is type(right):
            if kind is int:
                return apply(left, right)
            if kind is bytes or kind is str:
                runtime.charge(ORDER_GAS + (min(len(left), len(right)) >> compare_shift(left, right)))
                return apply(left, right)
        raise type_fault(sign, left, right)

    return run


def contains(runtime: Runtime, item: Any, container: Any) -> bool:
    """`item in container`: an element, dict key, or part of text or bytes."""
    kind = type(container)
    if kind is dict:
        charge_key(runtime, container, item)
        return item in container
    if kind is list or kind is tuple:
        return find_item(runtime, container, item) >= 0
    if kind is str and type(item) is str:
        charge_search(runtime, container, item)
        return item in container
    if kind is bytes and type(item) is bytes:
        charge_search(runtime, container, item)
        return item in container
    if kind is bytes and type(item) is int:
        runtime.charge(2 + (len(container) >> 9))
        return 0 <= item < 256 and item in container
    if kind is range and type(item) is int:
        return item in container
    raise type_fault("'in'", item, container)


def find_item(runtime: Runtime, items: Any, wanted: Any) -> int:
    """Return the first index of `wanted`, or -1."""
    runtime.gas -= 1
    if runtime.gas < 0:
        runtime.exhausted()
    for index, item in enumerate(items):
        runtime.gas -= 3
        if runtime.gas < 0:
            runtime.exhausted()
        if equal(runtime, item, wanted):
            return index
    return -1


def charge_search(runtime: Runtime, text: Any, part: Any, times: int = 1, *, every: bool = False) -> None:
    """Charge a search beforehand, by how often the last letter of `part` stands in `text`.

    `times` repeats it; `every` continues past the first match.
    """
    size, width = len(text), len(part)
    if size < 64 or not width:
        runtime.charge(SEARCH_GAS)
    elif width == 1:
        runtime.charge(SEARCH_GAS + (times * (size >> 5) if every else size >> 8))
    elif size < 2500 or width < 6 or (width < 100 and size < 30000):
        runtime.charge(SEARCH_GAS + times * (size >> 5))
        runtime.charge(times * (text.count(part[-1:]) * (width + 14) >> 9))
    else:
        runtime.charge(SEARCH_GAS + (size >> 7) + times * ((size + width) >> 5))


def not_contains(runtime: Runtime, item: Any, container: Any) -> bool:
    return not contains(runtime, item, container)


def _key_text(key: Any) -> str:
    if type(key) is str and len(key) <= 32 and key.isascii() and key.replace("-", "_").isidentifier():
        return f" {key!r}"
    return ""


def get_item(runtime: Runtime, container: Any, key: Any) -> Any:
    kind = type(container)
    if kind is dict:
        if type(key) is not str:
            charge_key(runtime, container, key)
        value = container.get(key, MISSING)
        if value is not MISSING:
            return value
        raise Fault(KEY_ERROR, f"The dict has no key{_key_text(key)}.")
    if kind in _INDEXED:
        return container[check_index(container, key)]
    raise type_fault("Indexing", container)


_INDEXED = frozenset((list, tuple, str, bytes, range))


def check_index(container: Any, index: Any) -> int:
    """Return a valid index (negative from the end). Raises INDEX_ERROR."""
    count = len(container)
    if -count <= need_int(index, "An index") < count:
        return int(index)
    raise Fault(INDEX_ERROR, f"The index is outside a {type(container).__name__} of {count} items.")


def get_slice(runtime: Runtime, container: Any, start: Any, stop: Any) -> Any:
    kind = type(container)
    if kind not in (list, tuple, str, bytes):
        raise type_fault("Slicing", container)
    for bound in (start, stop):
        if bound is not None:
            need_int(bound, "A slice bound")
    first, last, _ = slice(start, stop).indices(len(container))
    count = max(last - first, 0)
    unit = ITEM_BYTES if kind is list or kind is tuple else 1
    if kind is str and not container.isascii():
        unit = 4
    runtime.charge(SLICE_GAS)
    runtime.allocate(HEADER_BYTES + unit * count)
    return container[first:last]


def set_item(runtime: Runtime, container: Any, key: Any, value: Any) -> None:
    kind = type(container)
    if kind is dict:
        charge_key(runtime, container, key)
        if key not in container:
            runtime.allocate(DICT_ENTRY_BYTES)
        container[key] = value
    elif kind is list:
        container[check_index(container, key)] = value
    else:
        raise type_fault("Assignment to an item", container)


def delete_item(runtime: Runtime, container: Any, key: Any) -> None:
    kind = type(container)
    if kind is dict:
        charge_key(runtime, container, key)
        if key not in container:
            raise Fault(KEY_ERROR, f"The dict has no key{_key_text(key)}.")
        runtime.charge(DELETE_GAS)
        del container[key]
        close_holes(container)
    elif kind is list:
        index = check_index(container, key)
        runtime.charge(len(container) >> SHIFT_SHIFT)
        del container[index]
    else:
        raise type_fault("'del'", container)


def close_holes(entries: dict[Any, Any]) -> None:
    """Rebuild a dict in place if deleted entries dominate: walks would pass them all."""
    if entries.__sizeof__() > HOLES_MIN_BYTES + HOLES_ENTRY_BYTES * len(entries):
        kept = list(entries.items())
        entries.clear()
        entries.update(kept)


def iterate(runtime: Runtime, value: Any) -> Iterable[Any]:
    """Return what a `for` runs over; for a dict a snapshot of its keys."""
    kind = type(value)
    if kind is dict:
        runtime.charge(KEYS_GAS)
        runtime.allocate(HEADER_BYTES + ITEM_BYTES * len(value))
        return list(value)
    if kind in _INDEXED:
        iterable: Iterable[Any] = value
        return iterable
    raise type_fault("A loop", value)


def unpack(runtime: Runtime, value: Any, count: int) -> Any:
    if type(value) is not tuple and type(value) is not list:
        raise type_fault("Unpacking", value)
    if len(value) != count:
        raise Fault(VALUE_ERROR, f"There are {len(value)} items to unpack into {count} names.")
    return value


BINARY: dict[str, Operation] = {
    "Add": add,
    "Sub": subtract,
    "Mult": multiply,
    "FloorDiv": floor_divide,
    "Mod": modulo,
    "Pow": power,
    "LShift": shift_left,
    "RShift": shift_right,
    "BitAnd": _bitwise("'&'", operator.and_),
    "BitOr": _bitwise("'|'", operator.or_),
    "BitXor": _bitwise("'^'", operator.xor),
}
ARITHMETIC: dict[Operation, Callable[[int, int], int]] = {
    add: operator.add,
    subtract: operator.sub,
    multiply: operator.mul,
}
"""What these come to for two ints: the operator itself, and the check that 256 bits hold the result."""
UNARY: dict[str, Callable[[Runtime, Any], Any]] = {"USub": negate, "UAdd": plus, "Invert": invert}
ORDER: dict[str, Callable[[Any, Any], bool]] = {
    "Lt": operator.lt,
    "LtE": operator.le,
    "Gt": operator.gt,
    "GtE": operator.ge,
}
COMPARE: dict[str, Operation] = {
    "Eq": equal,
    "NotEq": not_equal,
    "Lt": _order("'<'", operator.lt),
    "LtE": _order("'<='", operator.le),
    "Gt": _order("'>'", operator.gt),
    "GtE": _order("'>='", operator.ge),
    "In": contains,
    "NotIn": not_contains,
}

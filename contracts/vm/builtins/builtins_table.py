"""The builtins of contracts; none returns a Python object to a contract."""
# ruff: noqa: ARG001 - one signature for all builtins

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from contracts.vm.builtins.methods import INT_BYTES_MAX, list_of, sorted_list
from contracts.vm.builtins.operations import RANGE_LIMIT
from contracts.vm.model.faults import VALUE_ERROR, Fault, is_author_code
from contracts.vm.model.meter import Runtime
from contracts.vm.model.values import (
    DICT_ENTRY_BYTES,
    HEADER_BYTES,
    ITEM_BYTES,
    MISSING,
    charge_int_keys,
    charge_key,
    check_int,
    need_bytes,
    need_int,
    need_str,
    type_fault,
    unit_bytes,
)

_SIZED = frozenset((str, bytes, list, dict, tuple, range))
_INT_TEXT = re.compile(r"[+-]?[0-9]{1,78}", re.ASCII)
_HEX_TEXT = re.compile(r"[0-9a-fA-F]*", re.ASCII)
"""One class, repeated: `re` takes memory for each step of a repeated group."""
TYPES: dict[str, type] = {
    "bool": bool, "int": int, "str": str, "bytes": bytes, "list": list, "dict": dict, "tuple": tuple,
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Builtin:
    """One builtin: function (runtime first), parameters, required count, whether variadic."""

    run: Callable[..., Any]
    params: tuple[str, ...]
    required: int
    variadic: bool = False


def _length(runtime: Runtime, value: Any) -> int:
    if type(value) in _SIZED:
        return len(value)
    raise type_fault("len", value)


def _range(runtime: Runtime, first: Any, second: Any = MISSING, step: Any = 1) -> range:
    start, stop = (0, first) if second is MISSING else (first, second)
    for number in (start, stop, step):
        if not -RANGE_LIMIT < need_int(number, "range") < RANGE_LIMIT:
            raise Fault(VALUE_ERROR, "A range goes up to 60 bits.")
    if step == 0:
        raise Fault(VALUE_ERROR, "The step of a range is zero.")
    runtime.charge(5)
    runtime.allocate(HEADER_BYTES)
    return range(start, stop, step)


def _extreme(name: str, reverse: bool) -> Callable[..., Any]:
    def run(runtime: Runtime, *values: Any) -> Any:
        if len(values) == 2 and type(values[0]) is int and type(values[1]) is int:
            return (max if reverse else min)(values)
        source = values[0] if len(values) == 1 else values
        items = sorted_list(runtime, source)
        if not items:
            raise Fault(VALUE_ERROR, f"{name} of nothing.")
        return items[-1 if reverse else 0]

    return run


def _sum(runtime: Runtime, values: Any) -> int:
    items = list_of(runtime, values)
    runtime.charge(1 + 2 * len(items))
    total = 0
    for item in items:
        total = check_int(total + need_int(item, "sum"))
    return total


def _absolute(runtime: Runtime, value: Any) -> int:
    return abs(need_int(value, "abs"))


def _any(runtime: Runtime, values: Any) -> bool:
    items = list_of(runtime, values)
    runtime.charge(len(items) >> 3)
    return any(items)


def _all(runtime: Runtime, values: Any) -> bool:
    items = list_of(runtime, values)
    runtime.charge(len(items) >> 3)
    return all(items)


def _sorted(runtime: Runtime, values: Any, reverse: Any = False) -> list[Any]:
    return sorted_list(runtime, values, reverse)


def _reversed(runtime: Runtime, values: Any) -> list[Any]:
    items = list_of(runtime, values)
    items.reverse()
    return items


def _enumerate(runtime: Runtime, values: Any, start: Any = 0) -> list[Any]:
    items = list_of(runtime, values)
    first = need_int(start, "enumerate")
    check_int(first + len(items))
    runtime.charge(2 + len(items))
    runtime.allocate((HEADER_BYTES + 3 * ITEM_BYTES) * len(items))
    return list(enumerate(items, first))


def _zip(runtime: Runtime, *sequences: Any) -> list[Any]:
    columns = [list_of(runtime, sequence) for sequence in sequences]
    shortest = min(len(column) for column in columns)
    runtime.charge(4 + 4 * len(columns) + shortest)
    runtime.allocate((HEADER_BYTES + ITEM_BYTES * len(columns)) * shortest)
    return list(zip(*columns, strict=False))


def _bool(runtime: Runtime, value: Any) -> bool:
    return bool(value)


def _int(runtime: Runtime, value: Any) -> int:
    if type(value) is int or type(value) is bool:
        return int(value)
    runtime.charge(16)
    if type(value) is str and _INT_TEXT.fullmatch(value) is not None:
        return check_int(int(value))
    if type(value) is str:
        raise Fault(VALUE_ERROR, "The text is not a decimal number of at most 78 digits.")
    raise type_fault("int", value)


def text_of(runtime: Runtime, value: Any) -> str:
    kind = type(value)
    if kind is str:
        return str(value)
    if kind is int:
        runtime.charge(value.bit_length() >> 5)
        runtime.allocate(96)
        return str(value)
    if kind is bool or value is None:
        return str(value)
    raise type_fault("A text", value)


def _list(runtime: Runtime, values: Any = ()) -> list[Any]:
    return list_of(runtime, values)


def _tuple(runtime: Runtime, values: Any = ()) -> tuple[Any, ...]:
    return tuple(list_of(runtime, values))


def _dict(runtime: Runtime, value: Any = MISSING) -> dict[Any, Any]:
    if value is MISSING:
        runtime.allocate(HEADER_BYTES)
        return {}
    if type(value) is dict:
        runtime.allocate(HEADER_BYTES + DICT_ENTRY_BYTES * len(value))
        charge_int_keys(runtime, value)
        return dict(value)
    result: dict[Any, Any] = {}
    for pair in list_of(runtime, value):
        if type(pair) not in (list, tuple) or len(pair) != 2:
            raise Fault(VALUE_ERROR, "A dict is made of another dict or of pairs.")
        charge_key(runtime, result, pair[0])
        runtime.charge(6)
        runtime.allocate(DICT_ENTRY_BYTES)
        result[pair[0]] = pair[1]
    return result


def _bytes(runtime: Runtime, value: Any = MISSING) -> bytes:
    if value is MISSING:
        return b""
    if type(value) is bytes:
        return value
    if type(value) is int:
        if value < 0:
            raise Fault(VALUE_ERROR, "A length is not negative.")
        runtime.allocate(HEADER_BYTES + value)
        return bytes(value)
    items = list_of(runtime, value)
    runtime.charge(2 * len(items))
    for item in items:
        if not 0 <= need_int(item, "bytes") < 256:
            raise Fault(VALUE_ERROR, "A byte is 0 to 255.")
    return bytes(items)


def _bytes_from_hex(runtime: Runtime, text: Any) -> bytes:
    need_str(text, "bytes.fromhex")
    runtime.charge(3 + (len(text) >> 4))
    runtime.allocate(HEADER_BYTES + len(text))
    if len(text) % 2 or _HEX_TEXT.fullmatch(text) is None:
        raise Fault(VALUE_ERROR, "The text is not pairs of hexadecimal digits.")
    return bytes.fromhex(text)


def _int_from_bytes(runtime: Runtime, data: Any, byteorder: Any = "big", signed: Any = False) -> int:
    if len(need_bytes(data, "int.from_bytes")) > INT_BYTES_MAX:
        raise Fault(VALUE_ERROR, f"At most {INT_BYTES_MAX} bytes make an int.")
    if byteorder not in ("big", "little") or type(signed) is not bool:
        raise Fault(VALUE_ERROR, "The byte order is 'big' or 'little', and signed is True or False.")
    return check_int(int.from_bytes(data, byteorder, signed=signed))


def _fixed_width(name: str, width: int) -> Callable[..., bytes]:
    limit = 1 << (8 * width)

    def run(runtime: Runtime, number: Any) -> bytes:
        if not 0 <= need_int(number, name) < limit:
            raise Fault(VALUE_ERROR, f"{name} takes 0 to 2^{8 * width}-1.")
        runtime.charge(3)
        runtime.allocate(HEADER_BYTES + width)
        return int(number).to_bytes(width, "big")

    return run


def _string(runtime: Runtime, value: Any = "") -> str:
    return text_of(runtime, value)


def _require(runtime: Runtime, condition: Any, code: Any, message: Any = MISSING) -> None:
    if not condition:
        raise require_fault(code, message)


def require_fault(code: Any, message: Any = MISSING) -> Fault:
    if not is_author_code(need_str(code, "require")):
        return Fault(VALUE_ERROR, "The code given to require is not UPPER_SNAKE text, or is one of the machine's own.")
    text = f"The contract requires otherwise: {code}." if message is MISSING else need_str(message, "require")
    return Fault(code, text[:200])


def join_texts(runtime: Runtime, parts: list[str]) -> str:
    runtime.charge(4 + 3 * len(parts))
    runtime.allocate(HEADER_BYTES + unit_bytes(*parts) * sum(map(len, parts)))
    return "".join(parts)


BUILTINS: dict[str, Builtin] = {
    "len": Builtin(_length, ("value",), 1),
    "range": Builtin(_range, ("start", "stop", "step"), 1),
    "min": Builtin(_extreme("min", reverse=False), ("values",), 1, variadic=True),
    "max": Builtin(_extreme("max", reverse=True), ("values",), 1, variadic=True),
    "sum": Builtin(_sum, ("values",), 1),
    "abs": Builtin(_absolute, ("value",), 1),
    "any": Builtin(_any, ("values",), 1),
    "all": Builtin(_all, ("values",), 1),
    "sorted": Builtin(_sorted, ("values", "reverse"), 1),
    "reversed": Builtin(_reversed, ("values",), 1),
    "enumerate": Builtin(_enumerate, ("values", "start"), 1),
    "zip": Builtin(_zip, ("values",), 1, variadic=True),
    "bool": Builtin(_bool, ("value",), 1),
    "int": Builtin(_int, ("value",), 1),
    "str": Builtin(_string, ("value",), 0),
    "list": Builtin(_list, ("values",), 0),
    "tuple": Builtin(_tuple, ("values",), 0),
    "dict": Builtin(_dict, ("value",), 0),
    "bytes": Builtin(_bytes, ("value",), 0),
    "bytes.fromhex": Builtin(_bytes_from_hex, ("text",), 1),
    "int.from_bytes": Builtin(_int_from_bytes, ("data", "byteorder", "signed"), 1),
    "u32": Builtin(_fixed_width("u32", 4), ("number",), 1),
    "u64": Builtin(_fixed_width("u64", 8), ("number",), 1),
    "require": Builtin(_require, ("condition", "code", "message"), 2),
}

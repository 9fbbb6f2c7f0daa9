"""The method table by (name, type); Python attributes are never looked up.

Case mapping, `is...` and `strip` are ASCII-only: Unicode tables change with Python's version.
"""
# ruff: noqa: ARG001 - one signature for all methods

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from contracts.vm.builtins.operations import (
    DELETE_GAS,
    SHIFT_SHIFT,
    charge_search,
    check_index,
    close_holes,
    compare_shift,
    find_item,
    iterate,
)
from contracts.vm.model.faults import INDEX_ERROR, KEY_ERROR, VALUE_ERROR, Fault
from contracts.vm.model.meter import Runtime
from contracts.vm.model.values import (
    DICT_ENTRY_BYTES,
    HEADER_BYTES,
    ITEM_BYTES,
    MISSING,
    charge_int_keys,
    charge_key,
    need_int,
    text_bytes,
    type_fault,
    unit_bytes,
)

INT_BYTES_MAX = 33
UPDATE_GAS = 6
_STRIP_PIECE_CHARS = 64
STRIP_SHIFT = 1
WIDE_SORT_SHIFT = 6
"""Beyond ASCII a letter counts in sorting as 64 (2 to this power): texts may be compared letter by letter."""
_SPACE = " \t\n\r\x0b\x0c"
_UPPER = {code: code - 32 for code in range(97, 123)}
_LOWER = {code: code + 32 for code in range(65, 91)}


@dataclass(frozen=True, slots=True)
class Method:
    """One type's method: function, parameter names and required count."""

    run: Callable[..., Any]
    params: tuple[str, ...]
    required: int


METHODS: dict[str, dict[type, Method]] = {}
MethodFunction = TypeVar("MethodFunction", bound=Callable[..., Any])


def _method(
    kinds: type | tuple[type, ...], name: str, params: str = "", required: int | None = None
) -> Callable[[MethodFunction], MethodFunction]:
    names = tuple(params.split())

    def register(function: MethodFunction) -> MethodFunction:
        for kind in kinds if isinstance(kinds, tuple) else (kinds,):
            METHODS.setdefault(name, {})[kind] = Method(function, names, len(names) if required is None else required)
        return function

    return register


def _same(text: Any, part: Any, what: str) -> Any:
    if type(part) is not type(text):
        raise type_fault(what, part)
    return part


@_method((str, bytes), "startswith", "prefix")
def _startswith(runtime: Runtime, text: Any, prefix: Any) -> bool:
    _same(text, prefix, "startswith")
    runtime.charge(1 + (len(prefix) >> compare_shift(text, prefix)))
    return bool(text.startswith(prefix))


@_method((str, bytes), "endswith", "suffix")
def _endswith(runtime: Runtime, text: Any, suffix: Any) -> bool:
    _same(text, suffix, "endswith")
    runtime.charge(1 + (len(suffix) >> compare_shift(text, suffix)))
    return bool(text.endswith(suffix))


@_method((str, bytes), "find", "part")
def _find(runtime: Runtime, text: Any, part: Any) -> int:
    charge_search(runtime, text, _same(text, part, "find"))
    return int(text.find(part))


@_method((str, bytes), "count", "part")
def _count(runtime: Runtime, text: Any, part: Any) -> int:
    charge_search(runtime, text, _same(text, part, "count"), every=True)
    return int(text.count(part))


@_method((str, bytes), "replace", "old new")
def _replace(runtime: Runtime, text: Any, old: Any, new: Any) -> Any:
    charge_search(runtime, text, _same(text, old, "replace"), times=3, every=True)
    _same(text, new, "replace")
    hits = text.count(old)
    runtime.charge(10 + (hits >> (5 if type(text) is str else 4)))
    unit = unit_bytes(text, new) if type(text) is str else 1
    runtime.allocate(HEADER_BYTES + unit * (len(text) + hits * len(new)))
    return text.replace(old, new)


@_method((str, bytes), "split", "separator", 0)
def _split(runtime: Runtime, text: Any, separator: Any = MISSING) -> list[Any]:
    if separator is MISSING:
        separator = " " if type(text) is str else b" "
    charge_search(runtime, text, _same(text, separator, "split"), times=2, every=True)
    if not separator:
        raise Fault(VALUE_ERROR, "The separator is empty.")
    pieces = text.count(separator) + 1
    runtime.charge(4 + (pieces >> 2))
    unit = unit_bytes(text) if type(text) is str else 1
    runtime.allocate(HEADER_BYTES + (ITEM_BYTES + HEADER_BYTES) * pieces + unit * len(text))
    result: list[Any] = text.split(separator)
    return result


@_method((str, bytes), "join", "parts")
def _join(runtime: Runtime, text: Any, parts: Any) -> Any:
    if type(parts) not in (list, tuple):
        raise type_fault("join", parts)
    runtime.charge(4 + 2 * len(parts))
    size = 0
    ascii_only = type(text) is bytes or text.isascii()
    for part in parts:
        size += len(_same(text, part, "join")) + len(text)
        ascii_only = ascii_only and (type(part) is bytes or part.isascii())
    runtime.allocate(HEADER_BYTES + (size if ascii_only else 4 * size))
    return text.join(parts)


def _strip_set(text: Any, characters: Any) -> Any:
    if characters is MISSING:
        return _SPACE if type(text) is str else _SPACE.encode()
    _same(text, characters, "strip")
    if len(characters) > 64:
        raise Fault(VALUE_ERROR, "At most 64 characters can be stripped.")
    return characters


def _piece_gas(characters: Any) -> int:
    if type(characters) is bytes:
        return 5
    return 10 if characters.isascii() else 10 + (len(characters) >> STRIP_SHIFT)


def _strip_left(runtime: Runtime, text: Any, characters: Any) -> Any:
    start, price = 0, _piece_gas(characters)
    while start < len(text):
        runtime.charge(price)
        if text[start : start + _STRIP_PIECE_CHARS].lstrip(characters):
            break
        start += _STRIP_PIECE_CHARS
    return text[start:].lstrip(characters)


def _strip_right(runtime: Runtime, text: Any, characters: Any) -> Any:
    stop, price = len(text), _piece_gas(characters)
    while stop > 0:
        runtime.charge(price)
        if text[max(stop - _STRIP_PIECE_CHARS, 0) : stop].rstrip(characters):
            break
        stop -= _STRIP_PIECE_CHARS
    return text[: max(stop, 0)].rstrip(characters)


def _charge_stripped(runtime: Runtime, text: Any) -> None:
    runtime.charge(5)
    runtime.allocate(HEADER_BYTES + (len(text) if type(text) is bytes or text.isascii() else 4 * len(text)))


@_method((str, bytes), "strip", "characters", 0)
def _strip(runtime: Runtime, text: Any, characters: Any = MISSING) -> Any:
    characters = _strip_set(text, characters)
    _charge_stripped(runtime, text)
    return _strip_right(runtime, _strip_left(runtime, text, characters), characters)


@_method((str, bytes), "lstrip", "characters", 0)
def _lstrip(runtime: Runtime, text: Any, characters: Any = MISSING) -> Any:
    characters = _strip_set(text, characters)
    _charge_stripped(runtime, text)
    return _strip_left(runtime, text, characters)


@_method((str, bytes), "rstrip", "characters", 0)
def _rstrip(runtime: Runtime, text: Any, characters: Any = MISSING) -> Any:
    characters = _strip_set(text, characters)
    _charge_stripped(runtime, text)
    return _strip_right(runtime, text, characters)


@_method(str, "upper")
def _upper(runtime: Runtime, text: str) -> str:
    runtime.charge(1 + (len(text) >> 6) if text.isascii() else 2 + len(text))
    runtime.allocate(text_bytes(text))
    return text.upper() if text.isascii() else text.translate(_UPPER)


@_method(str, "lower")
def _lower(runtime: Runtime, text: str) -> str:
    runtime.charge(1 + (len(text) >> 6) if text.isascii() else 2 + len(text))
    runtime.allocate(text_bytes(text))
    return text.lower() if text.isascii() else text.translate(_LOWER)


def _ascii_test(name: str, test: Callable[[str], bool]) -> None:
    def run(runtime: Runtime, text: str) -> bool:
        runtime.charge(1 + (min(len(text), 64) >> 4))
        if not text.isascii() or not test(text[:64]):
            return False
        if len(text) <= 64:
            return True
        runtime.charge(len(text) >> 4)
        return test(text)

    METHODS.setdefault(name, {})[str] = Method(run, (), 0)


_ascii_test("isdigit", str.isdigit)
_ascii_test("isalpha", str.isalpha)
_ascii_test("isalnum", str.isalnum)
_ascii_test("isupper", str.isupper)
_ascii_test("islower", str.islower)


@_method(str, "isascii")
def _isascii(runtime: Runtime, text: str) -> bool:
    runtime.charge(1)
    return text.isascii()


@_method(str, "encode")
def _encode(runtime: Runtime, text: str) -> bytes:
    runtime.charge(1 if text.isascii() else 2 + (len(text) >> 6))
    runtime.allocate(text_bytes(text))
    return text.encode()


@_method(bytes, "decode")
def _decode(runtime: Runtime, data: bytes) -> str:
    runtime.charge(1 + (len(data) >> 7))
    runtime.allocate(HEADER_BYTES + 4 * len(data))
    try:
        return data.decode()
    except UnicodeDecodeError:
        raise Fault(VALUE_ERROR, "The bytes are not UTF-8.") from None


@_method(bytes, "hex")
def _hex(runtime: Runtime, data: bytes) -> str:
    runtime.charge(1 + (len(data) >> 6))
    runtime.allocate(HEADER_BYTES + 2 * len(data))
    return data.hex()


@_method(int, "bit_length")
def _bit_length(runtime: Runtime, number: int) -> int:
    return number.bit_length()


@_method(int, "to_bytes", "length byteorder signed", 1)
def _to_bytes(runtime: Runtime, number: int, length: Any, byteorder: Any = "big", signed: Any = False) -> bytes:
    if not 0 <= need_int(length, "to_bytes") <= INT_BYTES_MAX:
        raise Fault(VALUE_ERROR, f"An int makes 0 to {INT_BYTES_MAX} bytes.")
    if byteorder not in ("big", "little") or type(signed) is not bool:
        raise Fault(VALUE_ERROR, "The byte order is 'big' or 'little', and signed is True or False.")
    runtime.charge(4)
    runtime.allocate(HEADER_BYTES + length)
    try:
        return number.to_bytes(length, byteorder, signed=signed)
    except OverflowError:
        raise Fault(VALUE_ERROR, f"The int does not fit into {length} bytes.") from None


@_method(list, "append", "item")
def _append(runtime: Runtime, items: list[Any], item: Any) -> None:
    runtime.allocate(HEADER_BYTES)
    items.append(item)


@_method(list, "extend", "more")
def _extend(runtime: Runtime, items: list[Any], more: Any) -> None:
    source = list_of(runtime, more)
    runtime.allocate(ITEM_BYTES * len(source))
    items.extend(source)


@_method(list, "insert", "index item")
def _insert(runtime: Runtime, items: list[Any], index: Any, item: Any) -> None:
    place = max(min(need_int(index, "insert"), len(items)), -len(items))
    runtime.charge(3 + (len(items) >> SHIFT_SHIFT))
    runtime.allocate(HEADER_BYTES)
    items.insert(place, item)


@_method(list, "pop", "index", 0)
def _pop(runtime: Runtime, items: list[Any], index: Any = -1) -> Any:
    if not items:
        raise Fault(INDEX_ERROR, "The list is empty.")
    place = check_index(items, index)
    runtime.charge(1 + (len(items) >> SHIFT_SHIFT) if place != -1 else 0)
    return items.pop(place)


@_method(list, "remove", "item")
def _remove(runtime: Runtime, items: list[Any], item: Any) -> None:
    place = find_item(runtime, items, item)
    if place < 0:
        raise Fault(VALUE_ERROR, "The list does not hold the item.")
    runtime.charge(len(items) >> SHIFT_SHIFT)
    del items[place]


@_method((list, tuple), "index", "item")
def _index(runtime: Runtime, items: Any, item: Any) -> int:
    place = find_item(runtime, items, item)
    if place < 0:
        raise Fault(VALUE_ERROR, "The sequence does not hold the item.")
    return place


@_method(list, "reverse")
def _reverse(runtime: Runtime, items: list[Any]) -> None:
    runtime.charge(1 + (len(items) >> 8))
    items.reverse()


@_method(list, "clear")
def _clear_list(runtime: Runtime, items: list[Any]) -> None:
    items.clear()


@_method(list, "copy")
def _copy_list(runtime: Runtime, items: list[Any]) -> list[Any]:
    runtime.allocate(HEADER_BYTES + ITEM_BYTES * len(items))
    return list(items)


@_method(list, "sort", "reverse", 0)
def _sort(runtime: Runtime, items: list[Any], reverse: Any = False) -> None:
    items[:] = sorted_list(runtime, items, reverse)


@_method(dict, "get", "key default", 1)
def _get(runtime: Runtime, entries: dict[Any, Any], key: Any, default: Any = None) -> Any:
    charge_key(runtime, entries, key)
    runtime.charge(1)
    return entries.get(key, default)


@_method(dict, "keys")
def _keys(runtime: Runtime, entries: dict[Any, Any]) -> list[Any]:
    runtime.charge(2 + (len(entries) >> 4))
    runtime.allocate(HEADER_BYTES + ITEM_BYTES * len(entries))
    return list(entries)


@_method(dict, "values")
def _values(runtime: Runtime, entries: dict[Any, Any]) -> list[Any]:
    runtime.charge(2 + (len(entries) >> 4))
    runtime.allocate(HEADER_BYTES + ITEM_BYTES * len(entries))
    return list(entries.values())


@_method(dict, "items")
def _items(runtime: Runtime, entries: dict[Any, Any]) -> list[Any]:
    runtime.charge(2 + (len(entries) >> 1))
    runtime.allocate(HEADER_BYTES + (ITEM_BYTES + HEADER_BYTES + 2 * ITEM_BYTES) * len(entries))
    return list(entries.items())


@_method(dict, "pop", "key default", 1)
def _pop_key(runtime: Runtime, entries: dict[Any, Any], key: Any, default: Any = MISSING) -> Any:
    charge_key(runtime, entries, key)
    if key in entries:
        runtime.charge(DELETE_GAS)
        value = entries.pop(key)
        close_holes(entries)
        return value
    if default is MISSING:
        raise Fault(KEY_ERROR, "The dict does not have the key.")
    return default


@_method(dict, "setdefault", "key default", 1)
def _setdefault(runtime: Runtime, entries: dict[Any, Any], key: Any, default: Any = None) -> Any:
    charge_key(runtime, entries, key)
    runtime.charge(2)
    if key not in entries:
        runtime.allocate(DICT_ENTRY_BYTES)
        entries[key] = default
    return entries[key]


@_method(dict, "update", "more")
def _update(runtime: Runtime, entries: dict[Any, Any], more: Any) -> None:
    if type(more) is not dict:
        raise type_fault("update", more)
    runtime.charge(UPDATE_GAS)
    runtime.allocate(DICT_ENTRY_BYTES * len(more))
    charge_int_keys(runtime, more, len(entries))
    entries.update(more)


@_method(dict, "copy")
def _copy_dict(runtime: Runtime, entries: dict[Any, Any]) -> dict[Any, Any]:
    runtime.allocate(HEADER_BYTES + DICT_ENTRY_BYTES * len(entries))
    charge_int_keys(runtime, entries)
    return dict(entries)


@_method(dict, "clear")
def _clear_dict(runtime: Runtime, entries: dict[Any, Any]) -> None:
    entries.clear()


def list_of(runtime: Runtime, value: Any) -> list[Any]:
    source = iterate(runtime, value)
    count = len(value)
    if count > runtime.memory:
        runtime.allocate(ITEM_BYTES * count)
    runtime.charge(5 + (count >> (2 if type(value) is range else 4)))
    runtime.allocate(HEADER_BYTES + ITEM_BYTES * count + (HEADER_BYTES * count if type(value) is str else 0))
    return list(source)


def sorted_list(runtime: Runtime, value: Any, reverse: Any = False) -> list[Any]:
    """Return sorted items; all must be int, all str or all bytes."""
    items = list_of(runtime, value)
    if type(reverse) is not bool:
        raise type_fault("reverse=", reverse)
    if not items:
        return items
    kind = type(items[0])
    if kind not in (int, str, bytes):
        raise type_fault("Sorting", items[0])
    count = len(items)
    runtime.charge(4 + (count >> 2))
    size = 0
    for item in items:
        if type(item) is not kind:
            raise type_fault("Sorting", items[0], item)
        if kind is bytes or (kind is str and item.isascii()):
            size += len(item)
        elif kind is str:
            size += len(item) << WIDE_SORT_SHIFT
    runtime.charge((count * (1 if kind is int else 2) + (size >> 9)) * count.bit_length() // 12)
    items.sort(reverse=reverse)
    return items

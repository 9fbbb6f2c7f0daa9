"""The ABI: types from annotations and argument checks; values are never converted.

Types: `int`, `str`, `bytes`, `bool`, `list`, `dict`, `tuple`, `object` (any), `None`, `list[T]`, `dict[K, V]`, unions
with `|`.
"""

from __future__ import annotations

import ast
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

from contracts.vm.model.faults import ARGUMENTS_INVALID, Fault
from contracts.vm.model.values import Mark

EntryKind = Literal["export", "view", "genesis", "migrate"]
Accepts = Callable[[Any], bool]

_PLAIN: dict[str, type] = {
    "int": int, "str": str, "bytes": bytes, "bool": bool, "list": list, "dict": dict, "tuple": tuple,
}  # fmt: skip
TYPE_HELP = "Use int, str, bytes, bool, list, dict, list[T], dict[K, V], object or None, joined by '|'."


@dataclass(frozen=True, slots=True)
class Entry:
    """A callable: parameters as (name, type), the first `required` mandatory."""

    name: str
    kind: EntryKind
    params: tuple[tuple[str, str], ...]
    returns: str
    required: int
    line: int


@dataclass(frozen=True, slots=True)
class Abi:
    """All entries in source order."""

    contract: str
    entries: tuple[Entry, ...]

    def entry(self, name: str) -> Entry | None:
        for entry in self.entries:
            if entry.name == name:
                return entry
        return None


def _is_none(value: Any) -> bool:
    return value is None


def _is_anything(value: Any) -> bool:
    return not isinstance(value, Mark)


def _accept_type(kind: type) -> Accepts:
    def accepts(value: Any) -> bool:
        return type(value) is kind

    return accepts


def _accept_list(item: Accepts) -> Accepts:
    def accepts(value: Any) -> bool:
        return type(value) is list and all(item(element) for element in value)

    return accepts


def _accept_dict(key: Accepts, item: Accepts) -> Accepts:
    def accepts(value: Any) -> bool:
        return type(value) is dict and all(key(name) and item(element) for name, element in value.items())

    return accepts


def _accept_either(first: Accepts, second: Accepts) -> Accepts:
    def accepts(value: Any) -> bool:
        return first(value) or second(value)

    return accepts


def parse_type(node: ast.expr | None) -> Accepts | None:
    """None if it is no type."""
    if isinstance(node, ast.Constant) and node.value is None:
        return _is_none
    if isinstance(node, ast.Name):
        if node.id == "object":
            return _is_anything
        return _accept_type(_PLAIN[node.id]) if node.id in _PLAIN else None
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.BitOr):
        left, right = parse_type(node.left), parse_type(node.right)
        return None if left is None or right is None else _accept_either(left, right)
    if isinstance(node, ast.Subscript) and isinstance(node.value, ast.Name):
        return _parse_container(node.value.id, node.slice)
    return None


def _parse_container(name: str, inside: ast.expr) -> Accepts | None:
    if name == "list":
        item = parse_type(inside)
        return None if item is None else _accept_list(item)
    if name == "dict" and isinstance(inside, ast.Tuple) and len(inside.elts) == 2:
        key, value = parse_type(inside.elts[0]), parse_type(inside.elts[1])
        return None if key is None or value is None else _accept_dict(key, value)
    return None


def type_text(node: ast.expr | None) -> str:
    """In canonical spelling; `object` if absent."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Constant):
        return "None"
    if isinstance(node, ast.BinOp):
        return f"{type_text(node.left)} | {type_text(node.right)}"
    if isinstance(node, ast.Subscript):
        return f"{type_text(node.value)}[{type_text(node.slice)}]"
    if isinstance(node, ast.Tuple):
        return ", ".join(type_text(element) for element in node.elts)
    return "object"


def count_choices(node: ast.expr | None) -> int:
    return 0 if node is None else sum(isinstance(part, ast.BitOr) for part in ast.walk(node))


def plain_types(params: tuple[tuple[str, str], ...]) -> list[type] | None:
    """Return the types if each parameter has one plain type, else None."""
    types = [_PLAIN[kind] for _, kind in params if kind in _PLAIN]
    return types if len(types) == len(params) else None


def check_arguments(entry: Entry, accepts: tuple[Accepts, ...], arguments: list[Any]) -> None:
    """Raises ARGUMENTS_INVALID; the walk was charged when arguments were copied in."""
    if not entry.required <= len(arguments) <= len(accepts):
        wanted = str(len(accepts)) if entry.required == len(accepts) else f"{entry.required} to {len(accepts)}"
        message = f"{entry.name} takes {wanted} arguments, not {len(arguments)}."
        raise Fault(ARGUMENTS_INVALID, message, entry.line)
    for position, value in enumerate(arguments):
        if not accepts[position](value):
            name, kind = entry.params[position]
            raise Fault(ARGUMENTS_INVALID, f"{entry.name}: the argument {name} is not of type {kind}.", entry.line)

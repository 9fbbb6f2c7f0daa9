"""Converts arguments typed as text to an entry's parameter types, and values to text.

`int` is decimal or 0x, `bytes` is 0x..., hex:... or text:..., `str` is literal, lists and dicts are JSON.
"""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Sequence
from typing import Any, Protocol, TypeVar

from consensus.bounded_text import read_json_text
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode_value
from contracts.vm.frontend.abi import parse_type

CODE = "CONTRACT_ARGUMENTS_INVALID"
TYPE_MAX_CHARS = 1_000
_INT = re.compile(r"[+-]?(0[xX][0-9a-fA-F]+|[0-9]+)", re.ASCII)
_HEX = re.compile(r"(?:0x|hex:)((?:[0-9a-fA-F]{2})*)", re.ASCII)
_WORDS = {"true": True, "false": False}
_NOTHING = {"null", "none", "None"}
_HELP = {
    "int": "a whole number, as 12, -3 or 0xff",
    "bytes": "bytes, as 0x00ff, hex:00ff or text:hello",
    "bool": "true or false",
    "None": "null",
    "list": "a JSON list",
    "dict": "a JSON object",
}


class Signature(Protocol):
    """An entry as compiled, or as the chain describes it: parameters as (name, type), the first `required` mandatory."""

    @property
    def name(self) -> str: ...
    @property
    def kind(self) -> str: ...
    @property
    def params(self) -> Sequence[tuple[str, str]]: ...
    @property
    def required(self) -> int: ...
    @property
    def returns(self) -> str: ...


_S = TypeVar("_S", bound=Signature)


class _MisfitError(Exception):
    """A text that does not fit one alternative of a type."""


def find_entry(contract: str, entries: Sequence[_S], name: str, kind: str) -> _S:
    """Raises TRANSACTION_CONTRACT_UNKNOWN."""
    entry = next((one for one in entries if one.name == name), None)
    if entry is not None and entry.kind == kind:
        return entry
    there = ", ".join(one.name for one in entries if one.kind == kind) or "none"
    what = f"is no {kind} but one marked @{entry.kind}" if entry is not None else f"is no {kind} of it"
    raise BlockRobotError("TRANSACTION_CONTRACT_UNKNOWN", f"{contract}.{name} {what}. There are: {there}.")


def signature_of(entry: Signature) -> str:
    """As `name(a: int, b: str = ...) -> list`."""
    parts = [
        f"{name}: {kind}" + ("" if place < entry.required else " = ...")
        for place, (name, kind) in enumerate(entry.params)
    ]
    return f"{entry.name}({', '.join(parts)}) -> {entry.returns}"


def read_arguments(entry: Signature, texts: Sequence[str]) -> list[Any]:
    """Raises CONTRACT_ARGUMENTS_INVALID, also for a type that is none."""
    if not entry.required <= len(texts) <= len(entry.params):
        wanted = str(len(entry.params))
        if entry.required != len(entry.params):
            wanted = f"{entry.required} to {wanted}"
        raise BlockRobotError(CODE, f"{signature_of(entry)} takes {wanted} arguments, not {len(texts)}.")
    values = []
    for text, (name, kind) in zip(texts, entry.params, strict=False):
        try:
            value = _read(text, _parse(kind))
            encode_value(value)
        except (_MisfitError, BlockRobotError):
            shown = text if len(text) <= 60 else text[:57] + "..."
            wanted = _HELP.get(kind, f"a {kind[:60]}")
            raise BlockRobotError(CODE, f"{entry.name}: {name} takes {wanted}; {shown!r} is none.") from None
        values.append(value)
    return values


def _parse(kind: str) -> ast.expr:
    try:
        return ast.parse(kind[:TYPE_MAX_CHARS], mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise _MisfitError from None


def _alternatives(node: ast.expr) -> list[ast.expr]:
    if isinstance(node, ast.BinOp):
        return [*_alternatives(node.left), *_alternatives(node.right)]
    return [node]


def _name(node: ast.expr) -> str:
    if isinstance(node, ast.Subscript):
        node = node.value
    return node.id if isinstance(node, ast.Name) else "None"


def _read(text: str, node: ast.expr) -> Any:
    alternatives = sorted(_alternatives(node), key=lambda one: _name(one) in {"str", "object"})
    for alternative in alternatives:
        try:
            return _read_one(text, alternative)
        except _MisfitError:
            continue
    raise _MisfitError


def _read_one(text: str, node: ast.expr) -> Any:  # noqa: PLR0911 - one per type
    match _name(node):
        case "str":
            return text
        case "int":
            return _to_int(text)
        case "bytes":
            return _to_bytes(text)
        case "bool":
            if text not in _WORDS:
                raise _MisfitError
            return _WORDS[text]
        case "None":
            if text not in _NOTHING:
                raise _MisfitError
            return None
        case "object":
            try:
                return _fit(read_json_text(text, parse_float=_no_float), node)
            except ValueError:
                return _fit(text, node)
    try:
        value = read_json_text(text, parse_float=_no_float)
    except ValueError:
        raise _MisfitError from None
    return _fit(value, node)


def _no_float(text: str) -> Any:
    raise ValueError(text)


def _to_int(text: str) -> int:
    if _INT.fullmatch(text) is None or len(text) > 80:
        raise _MisfitError
    return int(text, 16) if "x" in text.lower() else int(text)


def _to_bytes(text: str) -> bytes:
    if text.startswith("text:"):
        return text.removeprefix("text:").encode()
    found = _HEX.fullmatch(text)
    if found is None:
        raise _MisfitError
    return bytes.fromhex(found[1])


def _fit(value: Any, node: ast.expr) -> Any:
    alternatives = _alternatives(node)
    if len(alternatives) > 1:
        for alternative in sorted(alternatives, key=lambda one: _name(one) in {"str", "object"}):
            try:
                return _fit(value, alternative)
            except _MisfitError:
                continue
        raise _MisfitError
    inside = node.slice if isinstance(node, ast.Subscript) else None
    anything = ast.Name("object", ast.Load())
    match _name(node):
        case "list" if isinstance(value, list):
            return [_fit(item, inside or anything) for item in value]
        case "dict" if isinstance(value, dict):
            keys, items = inside.elts if isinstance(inside, ast.Tuple) else (anything, anything)
            return {_fit_key(key, keys): _fit(item, items) for key, item in value.items()}
        case "bytes" if isinstance(value, str):
            return _to_bytes(value)
        case "object":
            return _fit_anything(value)
    accepts = parse_type(node)
    if accepts is None or not accepts(value):
        raise _MisfitError
    return value


def _fit_key(text: str, node: ast.expr) -> Any:
    return _read(text, node) if _name(node) != "object" else _fit_anything(text)


def _fit_anything(value: Any) -> Any:
    if isinstance(value, str):
        if value.startswith("text:"):
            return value.removeprefix("text:")
        found = _HEX.fullmatch(value)
        return value if found is None else bytes.fromhex(found[1])
    if isinstance(value, list):
        return [_fit_anything(item) for item in value]
    if isinstance(value, dict):
        return {_fit_anything(key): _fit_anything(item) for key, item in value.items()}
    return value


def format_value(value: Any) -> str:
    if isinstance(value, bytes):
        return f"0x{value.hex()}"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, dict):
        return "{" + ", ".join(f"{format_value(key)}: {format_value(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(format_value(item) for item in value) + "]"
    if isinstance(value, tuple):
        return "(" + ", ".join(format_value(item) for item in value) + ("," if len(value) == 1 else "") + ")"
    return repr(value)


def format_short(value: Any, limit_chars: int = 60) -> str:
    text = format_value(value)
    return text if len(text) <= limit_chars else text[: limit_chars - 3] + "..."

"""Generates the reference page of contract state from consensus/state."""

from __future__ import annotations

import ast
import inspect
from collections.abc import Iterator
from itertools import pairwise
from types import ModuleType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import msgspec

from consensus.state.keys import HASH_BYTES, KEY_BYTES, RECORD_ID_BYTES, TEXT, U32_BYTES, U64_BYTES, ListRow, Row, Rows
from consensus.state.layout import MODULES
from node.api.openapi.markdown_tables import write_table

_PARTS = {
    KEY_BYTES: "key",
    HASH_BYTES: "hash",
    RECORD_ID_BYTES: "record",
    U32_BYTES: "u32",
    U64_BYTES: "u64",
    TEXT: "text",
}
_TYPES = {bytes: "bytes", int: "number", str: "text", bool: "true or false", Any: "any value", type(None): "nothing"}
_FORMS = {
    list: ("list of ", "", ""),
    dict: ("map of ", " to ", ""),
    tuple: ("[", ", ", "]"),
    Union: ("", " or ", ""),
    UnionType: ("", " or ", ""),
}
_INTRODUCTION = """\
# What the contracts keep

The keys and rows of the ledger's state, by contract. A flat key, as proofs have it, is the contract's name, a zero byte
and the contract's own key, which stands here. In a key `<key>` is a public key (33 bytes), `<hash>` a hash, a handle or
an id (32 bytes), `<record>` a record's id (16 bytes), `<text>` a name, `<u32>` and `<u64>` a number of 4 or 8 bytes,
big-endian. A value is in the [canonical encoding](formats.md). A row is a map by the names of its fields, or, where it
says so, a list in their order; a `time` is in milliseconds since 1970. A later version of a contract may add fields to a
map; who reads one passes over those.

What calls write these: [the contracts that govern the network](system-contracts.md). The schema in Python, for keys and
typed rows: `consensus/state/`."""


def describe_rows(module: ModuleType) -> Iterator[tuple[Rows[Any], str]]:
    body = ast.parse(inspect.getsource(module)).body
    words: dict[str, str] = {}
    for place, after in pairwise(body):
        if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) and isinstance(place, ast.AnnAssign):
            words[ast.unparse(place.target)] = str(after.value.value)
    names = {value: name for name, value in vars(module).items() if isinstance(value, Rows)}
    for rows in module.LAYOUT:
        yield rows, words.get(names[rows], "")


def rows_in(kind: Any) -> Iterator[type[msgspec.Struct]]:
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        yield kind
        for hint in get_type_hints(kind).values():
            yield from rows_in(hint)
    else:
        for argument in get_args(kind):
            yield from rows_in(argument)


def describe_type(kind: Any) -> str:
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is Literal:
        return " or ".join(f"`{value}`" if value else "empty" for value in arguments)
    if origin is not None:
        beginning, between, end = _FORMS[origin]
        many = "s" if origin is list and arguments[0] in (int, str) else ""
        return beginning + between.join(map(describe_type, arguments)) + many + end
    if kind in _TYPES:
        return _TYPES[kind]
    return f"[`{kind.__name__}`](#{kind.__name__.lower()})"


def _describe_key(rows: Rows[Any]) -> str:
    parts = (
        part.decode() if isinstance(part, bytes) else f"<{_PARTS.get(part, f'{part} bytes')}>" for part in rows.form
    )
    return f"`{rows.flat.partition(bytes(1))[2].decode()}{''.join(parts)}`"


def _describe_row(kind: type[msgspec.Struct]) -> list[str]:
    hints, defaults = get_type_hints(kind), kind.__struct_defaults__
    needed = len(kind.__struct_fields__) - len(defaults)
    cells = [
        [f"`{name}`", describe_type(hints[name]) + ("" if number < needed else "; may be missing")]
        for number, name in enumerate(kind.__struct_fields__)
    ]
    what = " ".join(str(inspect.getdoc(kind)).split()) + (" A list." if issubclass(kind, ListRow) else "")
    return [f"### `{kind.__name__}`", "", what, "", *write_table(["field", "type"], cells), ""]


def write_state_page(made: str) -> str:
    lines = [made, "", _INTRODUCTION, ""]
    described: set[type[msgspec.Struct]] = {Row, ListRow}
    for module in MODULES:
        known_rows = list(describe_rows(module))
        for contract in dict.fromkeys(rows.flat.partition(b"\x00")[0].decode() for rows, _ in known_rows):
            own = [(rows, words) for rows, words in known_rows if rows.flat.startswith(contract.encode() + b"\x00")]
            what = str(inspect.getdoc(module)).partition("\n")[0].partition("; and ")[0].rstrip(".") + "."
            lines += [f"## `{contract}`", "", what, ""]
            cells = [[_describe_key(rows), describe_type(rows.kind), words] for rows, words in own]
            lines += [*write_table(["key", "value", "what it says"], cells), ""]
            for kind in (kind for rows, _ in own for kind in rows_in(rows.kind)):
                if kind not in described:
                    described.add(kind)
                    lines += _describe_row(kind)
    return "\n".join(lines).rstrip() + "\n"

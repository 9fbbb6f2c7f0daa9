"""What commands answer with `--json`: msgspec Structs that are printed, documented and tested from one definition."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, TypeVar

import msgspec
from msgspec import Meta, Struct

Hex = Annotated[str, Meta(pattern="^([0-9a-f]{2})*$")]
Count = Annotated[int, Meta(ge=0)]
Height = Annotated[int, Meta(ge=0, extra_json_schema={"unit": "block height"})]
Ms = Annotated[int, Meta(extra_json_schema={"unit": "ms"})]
MsFloat = Annotated[float, Meta(extra_json_schema={"unit": "ms"})]
TimeMs = Annotated[int, Meta(extra_json_schema={"unit": "ms since 1970, UTC"})]
Seconds = Annotated[float, Meta(extra_json_schema={"unit": "s"})]


def doc(text: str) -> Meta:
    """A field's description, for `Annotated`; it says when the field is null or absent."""
    return Meta(description=text)


class Answer(Struct, frozen=True, kw_only=True):
    """An answer, or an object in one; `ok` is added when it is printed.

    A field of type `| None` may be null; one of type `| UnsetType` may be absent. The docstring of a whole answer says
    when `ok` is false although the command was not refused.
    """


class Problem(Answer, frozen=True, kw_only=True):
    """An error, as in a refusal."""

    code: Annotated[str, doc("The error's code")]
    detail: Annotated[str, doc("What happened")]
    next_step: Annotated[str, doc("What to do")]


class AnswerLine(Answer, frozen=True, kw_only=True):
    """An answer of which a command prints many, one a line, without `ok`."""


A = TypeVar("A", bound=Answer)


def extend(kind: type[A], part: Answer, /, **more: Any) -> A:
    """All fields of `part`, which is of a class that `kind` extends, and more. Raises TypeError."""
    return kind(**{name: getattr(part, name) for name in part.__struct_fields__}, **more)


def convert_row(row: Struct, kind: type[A]) -> A:
    """A row of the ledger, with byte strings in hexadecimal."""
    fields = msgspec.to_builtins(row, builtin_types=(bytes,))
    return msgspec.convert({name: _shown(value) for name, value in fields.items()}, kind)


def _shown(value: Any) -> Any:
    return value.hex() if isinstance(value, bytes) else value


AnswersByCommand = Mapping[str, type[Answer] | tuple[type[Answer], ...]]
"""The answer of each command, or one of several, by its words behind `blockrobot`."""


def list_kinds(answer: type[Answer] | tuple[type[Answer], ...]) -> tuple[type[Answer], ...]:
    return answer if isinstance(answer, tuple) else (answer,)


_OK = {"type": "object", "properties": {"ok": {"type": "boolean"}}, "required": ["ok"]}


def write_schema(answers: AnswersByCommand) -> dict[str, Any]:
    """JSON Schema (2020-12): what is under `commands` refers into `$defs`."""
    kinds = list(dict.fromkeys(kind for answer in answers.values() for kind in list_kinds(answer)))
    schemas, definitions = msgspec.json.schema_components(kinds, ref_template="#/$defs/{name}")
    of_kind = {
        kind: schema if issubclass(kind, AnswerLine) else {"allOf": [_OK, schema]}
        for kind, schema in zip(kinds, schemas, strict=True)
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "commands": {
            words: {"anyOf": [of_kind[kind] for kind in answer]} if isinstance(answer, tuple) else of_kind[answer]
            for words, answer in answers.items()
        },
        "$defs": dict(sorted(definitions.items())),
    }

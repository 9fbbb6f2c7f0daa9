"""The catalogue of texts (`texts/en.toml`, `texts/pt.toml`), and errors that its texts explain. Knows no command."""

from __future__ import annotations

import functools
import tomllib
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from consensus.errors import BlockRobotError

DEFAULT_LANGUAGE = "en"
ONE, OTHER = "one", "other"
BECAUSE = "because"
FOLDER = Path(__file__).with_name("texts")

Form = str | Mapping[str, str]
"""A text, or its plural forms: `one` and `other`, chosen by the value that is called `count`."""


def _flatten(table: Mapping[str, object], prefix: str = "") -> dict[str, Form]:
    flat: dict[str, Form] = {}
    for name, value in table.items():
        key = f"{prefix}{name}"
        if isinstance(value, str):
            flat[key] = value
        elif isinstance(value, Mapping) and set(value) == {ONE, OTHER}:
            flat[key] = MappingProxyType({form: str(text) for form, text in value.items()})
        elif isinstance(value, Mapping):
            flat.update(_flatten(value, f"{key}."))
        else:
            raise AssertionError(f"{key} is no text")
    return flat


@functools.cache
def load(language: str) -> Mapping[str, Form]:
    """By dotted keys (`records.none`)."""
    return MappingProxyType(_flatten(tomllib.loads((FOLDER / f"{language}.toml").read_text(encoding="utf-8"))))


def form_of(key: str, language: str, values: Mapping[str, object]) -> str:
    """The unformatted text, English if it is not translated; `count` selects the plural. Raises KeyError."""
    form = load(language).get(key)
    if form is None:
        form = load(DEFAULT_LANGUAGE)[key]
    return form if isinstance(form, str) else form[ONE if values["count"] == 1 else OTHER]


def refusal(code: str, key: str, /, **values: str | int) -> BlockRobotError:
    """From `because.KEY`: English for programs, localised for people."""
    return BlockRobotError(code, explain(key, DEFAULT_LANGUAGE, values), **{BECAUSE: key}, **values)


def explain(key: str, language: str, values: Mapping[str, Any]) -> str:
    """`because.KEY`, which names no command."""
    role = f"role.{values.get('role')}"
    if role in load(DEFAULT_LANGUAGE):
        values = {**values, "role": form_of(role, language, {})}
    form = form_of(f"{BECAUSE}.{key}", language, values)
    return form.format(**values) if values else form

"""Translations of command line and page: `texts/en.toml`, `texts/pt.toml`."""

from __future__ import annotations

import functools
import os
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import IO, Any

import click

from clients.wallet.cli.invocation import with_command_prefix
from consensus.contract_refusals import refusal_code
from consensus.errors import BlockRobotError

LANGUAGES = ("en", "pt")
DEFAULT_LANGUAGE = "en"
LANGUAGE_VARIABLE = "BLOCKROBOT_LANGUAGE"
ONE, OTHER = "one", "other"
_META_KEY = "blockrobot.language"
_BECAUSE = "because"
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


def _known(wanted: str) -> str | None:
    name = wanted.replace("-", "_").split(".")[0].split("@")[0].split("_")[0].lower()
    if name in LANGUAGES:
        return name
    return DEFAULT_LANGUAGE if name in {"c", "posix"} else None


def find_language(environment: Mapping[str, str] | None = None) -> str:
    """BLOCKROBOT_LANGUAGE, else locale (LC_ALL, LC_MESSAGES, LANG), else English."""
    environment = os.environ if environment is None else environment
    for variable in (LANGUAGE_VARIABLE, "LC_ALL", "LC_MESSAGES", "LANG"):
        wanted = environment.get(variable, "")
        if wanted:
            return _known(wanted) or DEFAULT_LANGUAGE
    return DEFAULT_LANGUAGE


def language_in_use() -> str:
    """The running command's."""
    context = click.get_current_context(silent=True)
    chosen = None if context is None else context.meta.get(_META_KEY)
    return chosen or find_language()


def choose_language(context: click.Context, language: str | None) -> None:
    """None: the environment's."""
    if language is not None:
        context.meta[_META_KEY] = language


def text(key: str, /, *, language: str | None = None, **values: object) -> str:
    """`count` selects the plural; commands get this wallet's options. Raises KeyError."""
    language = language or language_in_use()
    form = load(language).get(key)
    if form is None:
        form = load(DEFAULT_LANGUAGE)[key]
    if not isinstance(form, str):
        form = form[ONE if values["count"] == 1 else OTHER]
    return with_command_prefix(form, has_fields=True).format(**values) if values else with_command_prefix(form)


def refusal(code: str, key: str, /, **values: str | int) -> BlockRobotError:
    """From `because.KEY`: English for programs, localised for people."""
    return BlockRobotError(code, _say_because(key, DEFAULT_LANGUAGE, values), **{_BECAUSE: key}, **values)


def _say_because(key: str, language: str, values: Mapping[str, Any]) -> str:
    role = f"role.{values.get('role')}"
    if role in load(DEFAULT_LANGUAGE):
        values = {**values, "role": text(role, language=language)}
    return text(f"{_BECAUSE}.{key}", language=language, **values)


class WrongUsage(click.UsageError):
    """A usage error from `usage.KEY`, localised, English in JSON."""

    def __init__(self, key: str, /, **values: Any) -> None:
        super().__init__(text(f"usage.{key}", language=DEFAULT_LANGUAGE, **values))
        self.told = text(f"usage.{key}", **values)

    def show(self, file: IO[Any] | None = None) -> None:
        click.UsageError(self.told, self.ctx).show(file)


def code_text(table: str, code: str, *, language: str | None = None) -> str:
    """`code.TABLE.CODE`, or the code itself."""
    key = f"code.{table}.{code}"
    return text(key, language=language) if key in load(DEFAULT_LANGUAGE) else code


def reason_text(code: str, *, language: str | None = None) -> str:
    key = f"page.reason.{code}"
    return text(key, language=language) if key in load(DEFAULT_LANGUAGE) else code


def withheld_text(withheld: Sequence[tuple[str, int]], *, language: str | None = None) -> str:
    """Most frequent first."""
    ordered = sorted(withheld, key=lambda one: -one[1])
    if len(ordered) == 1:
        reasons = reason_text(ordered[0][0], language=language)
    else:
        reasons = "; ".join(
            text("records.withheld_part", language=language, count=count, reason=reason_text(code, language=language))
            for code, count in ordered
        )
    return text("records.withheld", language=language, count=sum(count for _, count in ordered), reasons=reasons)


def purposes_text(purposes: Sequence[str], *, language: str | None = None) -> str:
    return ", ".join(code_text("purpose", code, language=language) for code in purposes)


def section(prefix: str, language: str) -> dict[str, str | dict[str, str]]:
    """Unformatted, with plurals as {"one", "other"}."""
    start = f"{prefix}."
    texts = {**load(DEFAULT_LANGUAGE), **load(language)}
    return {
        key.removeprefix(start): with_command_prefix(form)
        if isinstance(form, str)
        else {name: with_command_prefix(one) for name, one in form.items()}
        for key, form in texts.items()
        if key.startswith(start)
    }


def describe_error(error: BlockRobotError, language: str | None = None) -> tuple[str, str]:
    """What happened and the next step, localised where possible; case-specific details stay English."""
    language = language or language_in_use()
    texts = load(language)
    meaning, next_step = texts.get(f"errors.{error.code}.meaning"), texts.get(f"errors.{error.code}.next_step")
    # The particulars stay as they are: paths and names in them may look like a command.
    detail = error.detail
    because = _because(error, language)
    if because:
        detail = because
    elif isinstance(meaning, str):
        meaning = with_command_prefix(meaning)
        detail = meaning if error.detail == error.entry.meaning else _with_particulars(meaning, error.detail, language)
    elif error.detail == error.entry.meaning:
        detail = with_command_prefix(error.detail)
    if error.next_step != error.entry.next_step:  # that of a contract's own code says more
        refused = refusal_code(str(error.context.get("contract_code", "")), error.detail)
        next_step = texts.get(f"refusals.{refused}")
    return detail, with_command_prefix(next_step if isinstance(next_step, str) else error.next_step)


def _with_particulars(meaning: str, detail: str, language: str) -> str:
    return text("ask.particulars", language=language, meaning=meaning, detail=detail)


def _because(error: BlockRobotError, language: str) -> str:
    values = dict(error.context)
    key = values.pop(_BECAUSE, None)
    if key is None:
        return ""
    english = _say_because(str(key), DEFAULT_LANGUAGE, values)
    if not error.detail.endswith(english):
        return ""
    return error.detail.removesuffix(english) + _say_because(str(key), language, values)


def error_text(error: BlockRobotError) -> str:
    detail, next_step = describe_error(error)
    return text("ask.error", detail=detail, code=error.code, next_step=next_step)

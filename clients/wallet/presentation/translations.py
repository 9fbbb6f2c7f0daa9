"""Texts of command line and page in the user's language; commands in them are named as this wallet is called."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import IO, Any

import click

from clients.wallet.presentation.invocation import with_command_prefix
from clients.wallet.text_catalogue import BECAUSE, DEFAULT_LANGUAGE, explain, form_of, load
from consensus.contract_refusals import refusal_code
from consensus.errors import BlockRobotError
from consensus.visible_text import one_entry

LANGUAGES = ("en", "pt")
LANGUAGE_VARIABLE = "BLOCKROBOT_LANGUAGE"
_META_KEY = "blockrobot.language"


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
    """The language of the running command."""
    context = click.get_current_context(silent=True)
    chosen = None if context is None else context.meta.get(_META_KEY)
    return chosen or find_language()


def choose_language(context: click.Context, language: str | None) -> None:
    """`language` None: the environment's."""
    if language is not None:
        context.meta[_META_KEY] = language


def text(key: str, /, *, language: str | None = None, **values: object) -> str:
    """`count` selects the plural; commands get this wallet's options. Raises KeyError."""
    form = form_of(key, language or language_in_use(), values)
    return with_command_prefix(form, has_fields=True).format(**values) if values else with_command_prefix(form)


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
    """Name the most frequent reason first."""
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
    key = values.pop(BECAUSE, None)
    if key is None:
        return ""
    english = explain(str(key), DEFAULT_LANGUAGE, values)
    if not error.detail.endswith(english):
        return ""
    return error.detail.removesuffix(english) + explain(str(key), language, values)


def error_text(error: BlockRobotError) -> str:
    detail, next_step = describe_error(error)
    return text("ask.error", detail=one_entry(detail), code=error.code, next_step=next_step)

"""Help and usage errors in the user's language. The English texts of our commands are the lookup keys, by paragraph
(`help.`); changed English stays untranslated. click's own words come from gettext (`messages.po`); programs get English.
"""

from __future__ import annotations

import copy
import gettext
import inspect
import re
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, TypeVar

import click

from clients.sdk.terminal.lazy_group import LazyGroup
from clients.sdk.terminal.terminal import EXIT_FAILED, wants_json
from clients.wallet.presentation.translations import LANGUAGES, language_in_use
from clients.wallet.text_catalogue import DEFAULT_LANGUAGE, FOLDER, load

C = TypeVar("C", bound=click.Command)

EXAMPLE = "Example:"
_PLACEHOLDER = re.compile(r"\b[A-Z]{2,}(?:[_ ][A-Z]+)*\b")
_CLICKS_DOMAIN = "messages"


def paragraphs(english: str) -> list[str]:
    return [" ".join(part.split()) for part in inspect.cleandoc(english).split("\n\n")]


def placeholders(usage: str) -> list[str]:
    """`FILE` of a usage line or option."""
    return _PLACEHOLDER.findall(usage)


def _translate(english: str, language: str) -> str:
    translated = load(language).get(f"help.{english}", english)
    assert isinstance(translated, str)
    return translated


def _with_placeholders(usage: str, language: str) -> str:
    return _PLACEHOLDER.sub(lambda found: _translate(found.group(), language), usage)


def _translate_paragraphs(english: str | None, language: str) -> str:
    """In an example only placeholders are translated."""
    return "\n\n".join(
        _translate(EXAMPLE, language) + _with_placeholders(part.removeprefix(EXAMPLE), language)
        if part.startswith(EXAMPLE)
        else _translate(part, language)
        for part in paragraphs(english or "")
    )


@contextmanager
def click_speaks(language: str) -> Iterator[None]:
    """Errors are shown before leaving."""
    if language == DEFAULT_LANGUAGE:
        yield
        return
    translation, folder = gettext.translation, gettext.bindtextdomain(_CLICKS_DOMAIN)
    # By the variable LANGUAGE every program that the command starts would be told too.
    gettext.translation = partial(translation, languages=[language])  # type: ignore[assignment]
    gettext.bindtextdomain(_CLICKS_DOMAIN, str(FOLDER))
    try:
        yield
    except click.ClickException as wrong:
        wrong.show()
        raise click.exceptions.Exit(wrong.exit_code) from wrong
    except (click.Abort, KeyboardInterrupt, EOFError) as stopped:
        if not isinstance(stopped, click.Abort):
            click.echo(err=True)  # behind the ^C that the terminal shows
        click.echo(gettext.gettext("Aborted!"), err=True)
        raise click.exceptions.Exit(EXIT_FAILED) from stopped
    finally:
        gettext.bindtextdomain(_CLICKS_DOMAIN, folder)
        gettext.translation = translation


def _translated_copy(command: C, ctx: click.Context, language: str) -> C:
    """Translate the commands below it too."""
    translated = copy.copy(command)
    translated._help_option = None
    with click_speaks(language):
        translated.get_help_option(ctx)  # click makes it once, in the language of that moment
    translated.help, translated.short_help = (
        _translate_paragraphs(command.help, language),
        _translate_paragraphs(command.short_help, language),
    )
    translated.options_metavar = command.options_metavar and _with_placeholders(command.options_metavar, language)
    translated.params = [copy.copy(param) for param in command.params]
    for param in translated.params:
        param.metavar = _with_placeholders(param.make_metavar(ctx), language)
        if isinstance(param, click.Option):
            param.help = _translate_paragraphs(param.help, language)
    if isinstance(translated, click.Group):
        translated.subcommand_metavar = _with_placeholders(translated.subcommand_metavar, language)
        translated.commands = {
            name: _translated_copy(each, ctx, language) for name, each in translated.commands.items()
        }
    if isinstance(translated, LazyGroup):
        translated.places = {
            name: place._replace(summary=_translate_paragraphs(place.summary, language))
            for name, place in translated.places.items()
        }
    return translated


class TranslatedGroup(LazyGroup):
    """A group in the language of `--language` or the environment."""

    language = DEFAULT_LANGUAGE

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        command = super().get_command(ctx, cmd_name)
        if command is None or self.language == DEFAULT_LANGUAGE:
            return command
        return _translated_copy(command, ctx, self.language)

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        language = self._language_of(args)
        group = self
        if language != DEFAULT_LANGUAGE:
            group = _translated_copy(self, click.Context(self, parent=parent), language)
            group.language = language
        with click_speaks(language):
            return super(TranslatedGroup, group).make_context(info_name, args, parent, **extra)

    def invoke(self, ctx: click.Context) -> Any:
        with click_speaks(self.language):
            return super().invoke(ctx)

    def _language_of(self, args: list[str]) -> str:
        """Before anything is parsed, even in an unparsable line."""
        if wants_json(args):
            return DEFAULT_LANGUAGE
        parser = copy.copy(self).make_parser(click.Context(self, resilient_parsing=True))
        parser.ignore_unknown_options = True
        given = parser.parse_args(list(args))[0].get("language")
        return given if given in LANGUAGES else language_in_use()

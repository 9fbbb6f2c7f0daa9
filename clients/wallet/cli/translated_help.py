"""Localised help and usage errors. English texts are the lookup keys, by paragraph (`help.`); changed English stays
untranslated, and programs get English.
"""

from __future__ import annotations

import contextlib
import copy
import inspect
import re
from typing import IO, Any, NoReturn

import click
from click.exceptions import NoArgsIsHelpError
from click.shell_completion import CompletionItem

from clients.sdk.terminal.lazy_group import LazyGroup
from clients.sdk.terminal.terminal import EXIT_FAILED
from clients.wallet.present.translations import (
    DEFAULT_LANGUAGE,
    LANGUAGES,
    WrongUsage,
    choose_language,
    language_in_use,
    load,
)

EXAMPLE = "Example:"
CLICKS_SENTENCES = (
    "No such option {name}. Did you mean {choice}?",
    "No such option {name}. (Did you mean one of: {choices}?)",
    "No such option {name}.",
    "No such command {name}. Did you mean {choice}?",
    "No such command {name}. (Did you mean one of: {choices}?)",
    "No such command {name}.",
    "Missing command.",
    "Missing argument {hint}. Choose from:\n\t{choices}",
    "Missing argument {hint}.",
    "Missing option {hint}. Choose from:\n\t{choices}",
    "Missing option {hint}.",
    "Option {name} does not take a value.",
    "Option {name} requires an argument.",
    "Got unexpected extra argument ({given})",
    "Got unexpected extra arguments ({given})",
    "Invalid value for {hint}: {message}",
    "{value} is not one of {choices}.",
    "{value} does not match the format {formats}.",
    "{value} does not match the formats {formats}.",
    "{value} is not a valid integer range.",
    "{value} is not a valid integer.",
    "{value} is not a valid float.",
    "{value} is not in the range {range}.",
    "{kind} {file} does not exist.",
    "{kind} {file} is a file.",
    "{kind} {file} is a directory.",
    "{kind} {file} is not readable.",
    "{kind} {file} is not writable.",
)
"""What click says of a command line, with what it puts in; of two that fit, the first is meant."""
_FIELD = re.compile(r"\\\{(\w+)\\\}")
_PLACEHOLDER = re.compile(r"\b[A-Z]{2,}(?:[_ ][A-Z]+)*\b")


def paragraphs(english: str) -> list[str]:
    return [" ".join(part.split()) for part in inspect.cleandoc(english).split("\n\n")]


def placeholders(usage: str) -> list[str]:
    """Return the placeholders (`FILE`) of a usage line or option."""
    return _PLACEHOLDER.findall(usage)


def _said(english: str) -> str:
    said = load(language_in_use()).get(f"help.{english}", english)
    assert isinstance(said, str)
    return said


def _with_placeholders(usage: str) -> str:
    return _PLACEHOLDER.sub(lambda found: _said(found.group()), usage)


def _write_usage(ctx: click.Context, formatter: click.HelpFormatter) -> None:
    usage = _with_placeholders(" ".join(ctx.command.collect_usage_pieces(ctx)))
    formatter.write_usage(ctx.command_path, usage, prefix=f"{_said('Usage:')} ")


def _told_sentence(english: str) -> str:
    for sentence in CLICKS_SENTENCES:
        found = re.fullmatch(_FIELD.sub(r"(?P<\1>.+)", re.escape(sentence)), english, re.DOTALL)
        if found is not None:
            values = found.groupdict()
            if "hint" in values:
                values["hint"] = _with_placeholders(values["hint"])
            if "message" in values:
                values["message"] = _told_sentence(values["message"])
            return _said(sentence).format(**values)
    return english


class _SpokenUsageError(click.UsageError):
    """A usage error localised for people, English for programs."""

    def __init__(self, wrong: click.UsageError) -> None:
        super().__init__(wrong.format_message(), wrong.ctx)
        told = wrong.told if isinstance(wrong, WrongUsage) else _told_sentence(self.message)
        self._told = _said("Error: {message}").format(message=told)
        if wrong.ctx is not None:
            formatter = wrong.ctx.make_formatter()
            _write_usage(wrong.ctx, formatter)
            hint = _said("Try '{command} --help' for help.").format(command=wrong.ctx.command_path)
            self._told = f"{formatter.getvalue()}{hint}\n\n{self._told}"

    def show(self, file: IO[Any] | None = None) -> None:
        click.echo(self._told, file=file, err=file is None)


def _tell_wrong_usage(wrong: click.UsageError) -> NoReturn:
    with contextlib.nullcontext() if wrong.ctx is None else wrong.ctx.scope(cleanup=False):
        if language_in_use() == DEFAULT_LANGUAGE or isinstance(wrong, NoArgsIsHelpError):
            raise wrong
        raise _SpokenUsageError(wrong) from wrong


def _told(english: str | None) -> str:
    return "\n\n".join(
        f"{_said(EXAMPLE)}{_with_placeholders(part.removeprefix(EXAMPLE))}" if part.startswith(EXAMPLE) else _said(part)
        for part in paragraphs(english or "")
    )


def _told_short(english: str | None, limit: int) -> str:
    return click.Command(None, help=_told(english)).get_short_help_str(limit)


def _told_copy(command: click.Command, ctx: click.Context) -> click.Command:
    told = copy.copy(command)
    told.help = _told(command.help)
    told.params = [copy.copy(param) for param in command.get_params(ctx)]
    told.add_help_option = False  # it is among them
    for param in told.params:
        if isinstance(param, click.Option):
            param.help = _told(param.help)
    if isinstance(told, LazyGroup):
        told.places = {name: place._replace(summary=_told(place.summary)) for name, place in told.places.items()}
    elif isinstance(told, click.Group):
        told.commands = {name: _told_copy(each, ctx) for name, each in told.commands.items()}
    return told


def _shown_commands(group: click.Group) -> dict[str, str | None]:
    if isinstance(group, LazyGroup):
        return {name: group.places[name].summary for name in group.visible_commands()}
    return {name: each.short_help or each.help for name, each in group.commands.items() if not each.hidden}


class SpokenContext(click.Context):
    """A command context with localised help."""

    def get_help(self) -> str:
        if language_in_use() == DEFAULT_LANGUAGE:
            return super().get_help()
        command, formatter = self.command, self.make_formatter()
        _write_usage(self, formatter)
        formatter.write_paragraph()
        with formatter.indentation():
            formatter.write_text(_told(command.help))
        with formatter.section(_said("Options")):
            options = [param for param in command.get_params(self) if isinstance(param, click.Option)]
            formatter.write_dl([self._option_row(option) for option in options if not option.hidden])
        if isinstance(command, click.Group):
            shown = _shown_commands(command)
            limit = formatter.width - 6 - max(map(len, shown))
            with formatter.section(_said("Commands")):
                formatter.write_dl([(name, _told_short(shown[name], limit)) for name in sorted(shown)])
        return formatter.getvalue().rstrip("\n")

    def _option_row(self, option: click.Option) -> tuple[str, str]:
        record, extra = option.get_help_record(self), option.get_help_extra(self)
        assert record is not None
        told = [_said("default: {default}").format(default=extra["default"])] if "default" in extra else []
        if "range" in extra:
            told.append(extra["range"])
        if "required" in extra:
            told.append(_said(extra["required"]))
        ending = f"[{'; '.join(told)}]" if told else ""
        return _with_placeholders(record[0]), "  ".join(filter(None, (_told(option.help), ending)))


class TranslatedGroup(LazyGroup):
    """A group with help in the language of `--language` or the environment."""

    context_class = SpokenContext

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        command = super().get_command(ctx, cmd_name)
        below = [] if command is None else [command]
        while below:
            each = below.pop()
            each.context_class = SpokenContext
            below.extend(each.commands.values() if isinstance(each, click.Group) else ())
        return command

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        try:
            return super().make_context(info_name, args, parent, **extra)
        except click.UsageError as wrong:
            _tell_wrong_usage(wrong)

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except click.UsageError as wrong:
            _tell_wrong_usage(wrong)
        except (click.Abort, KeyboardInterrupt, EOFError) as stopped:
            if language_in_use() == DEFAULT_LANGUAGE:
                raise
            if not isinstance(stopped, click.Abort):
                click.echo(err=True)  # behind the ^C that the terminal shows
            click.echo(_said("Aborted!"), err=True)
            ctx.exit(EXIT_FAILED)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Determine the language before `--help`, regardless of option order."""
        if args:
            parser = self.make_parser(ctx)
            parser.ignore_unknown_options = True  # what is unknown is told below, in the language that this finds
            given, _, _ = parser.parse_args(list(args))
            if given.get("language") in LANGUAGES:
                choose_language(ctx, given["language"])
        return super().parse_args(ctx, args)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name, command, rest = super().resolve_command(ctx, args)
        if command is not None and ctx.resilient_parsing:
            command = _told_copy(command, ctx)
        return name, command, rest

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        told: Any = _told_copy(self, ctx)
        ctx.command = told
        return LazyGroup.shell_complete(told, ctx, incomplete)

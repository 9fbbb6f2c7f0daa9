"""Command groups imported on first use."""

from __future__ import annotations

import difflib
import pkgutil
from collections.abc import Mapping, Sequence
from gettext import gettext as _
from gettext import ngettext
from typing import Any, NamedTuple

import click
from click.shell_completion import CompletionItem

_COMPLETION_MAX_CHARS = 45
"""As click cuts them."""
_SUMMARY_MAX_CHARS = 1_000
_LIKE_MIN = 0.6
_ALIKE_MAX_COUNT = 3


class LazyCommand(NamedTuple):
    """A command's location (`module:attribute`) and first help paragraph."""

    where: str
    summary: str
    hidden: bool = False


class LazyGroup(click.Group):
    """A lazily importing group; `places` is in help order."""

    def __init__(self, *args: Any, places: Mapping[str, LazyCommand], **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.places = dict(places)

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002 - click's signature
        return list(self.places)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        if cmd_name not in self.places:
            return None
        command: click.Command = pkgutil.resolve_name(self.places[cmd_name].where)
        return command

    def summary(self, name: str, limit: int = _SUMMARY_MAX_CHARS) -> str:
        return click.Command(None, help=self.places[name].summary).get_short_help_str(limit)

    def visible_commands(self) -> list[str]:
        return [name for name, place in self.places.items() if not place.hidden]

    def command_sections(self) -> Mapping[str, Sequence[str]]:
        return {_("Commands"): self.visible_commands()}

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        width = max(map(len, self.visible_commands()))
        for heading, names in self.command_sections().items():
            with formatter.section(heading):
                formatter.write_dl([(name.ljust(width), self.summary(name)) for name in names])

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Suggests similar spellings for unknown ones."""
        try:
            return super().resolve_command(ctx, args)
        except click.NoSuchCommand as unknown:
            raise click.NoSuchCommand(
                unknown.command_name, self._unknown_command_text(unknown.command_name, ctx), ctx=ctx
            ) from None

    def _unknown_command_text(self, name: str, ctx: click.Context) -> str:
        alike = sorted(self.commands_meant(ctx), key=lambda meant: -_likeness(name, meant))
        near = [meant for meant in alike if _likeness(name, meant) >= _LIKE_MIN][:_ALIKE_MAX_COUNT]
        message = _("No such command {name!r}.").format(name=name)
        if not near:
            return message
        guesses = ", ".join(map(repr, near))
        hint = ngettext("Did you mean {possibility}?", "(Did you mean one of: {possibilities}?)", len(near))
        return f"{message} {hint.format(possibility=guesses, possibilities=guesses)}"

    def commands_meant(self, ctx: click.Context) -> list[str]:  # noqa: ARG002 - a root group looks further
        return list(self.places)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Import as few commands as possible."""
        named = [
            CompletionItem(name, help=self.summary(name, _COMPLETION_MAX_CHARS))
            for name in self.visible_commands()
            if name.startswith(incomplete)
        ]
        return [*named, *click.Command.shell_complete(self, ctx, incomplete)]


def _likeness(name: str, meant: str) -> float:
    return difflib.SequenceMatcher(None, name, meant.rpartition(" ")[2]).ratio()

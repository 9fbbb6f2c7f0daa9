"""The group that every command line enters by: wrong usage is told as JSON too."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import Any

import click

from clients.sdk.terminal.ascii_output import prepare_output
from clients.sdk.terminal.lazy_group import LazyGroup
from clients.sdk.terminal.process_guard import guard_process
from clients.sdk.terminal.safe_output import safe_streams
from clients.sdk.terminal.terminal import EXIT_FAILED, fail
from consensus.errors import BlockRobotError

JSON_OPTION = "--json"


def wants_json(arguments: Sequence[str]) -> bool:
    """Tell whether a command line asks for JSON, also one that nobody can parse."""
    options = arguments[: arguments.index("--")] if "--" in arguments else arguments
    return JSON_OPTION in options


class RootGroup(LazyGroup):
    """A lazy group that tells wrong usage as every other error is told, where --json is on the command line.

    Its help has the commands by who uses them: `sections` names them under each heading.
    """

    def __init__(self, *args: Any, sections: Mapping[str, Sequence[str]], **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.sections = sections

    def command_sections(self) -> Mapping[str, Sequence[str]]:
        """Return the headings of the help, and the commands under each."""
        return self.sections

    def commands_meant(self, ctx: click.Context) -> list[str]:
        """Return all commands of all groups: `records` is one of the wallet's."""
        meant = super().commands_meant(ctx)
        for name in self.list_commands(ctx):
            command = self.get_command(ctx, name)
            if isinstance(command, click.Group):
                meant += [f"{name} {inner}" for inner in command.list_commands(ctx)]
        return meant

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        **extra: Any,
    ) -> Any:
        """Run what a command line says, and exit; see click.Command.main."""
        guard_process()
        prepare_output()
        with safe_streams():
            return self._run(args, prog_name, complete_var, standalone_mode=standalone_mode, **extra)

    def _run(
        self,
        args: Sequence[str] | None,
        prog_name: str | None,
        complete_var: str | None,
        *,
        standalone_mode: bool,
        **extra: Any,
    ) -> Any:
        given = sys.argv[1:] if args is None else list(args)
        if not standalone_mode or not wants_json(given):
            return super().main(args, prog_name, complete_var, standalone_mode=standalone_mode, **extra)
        try:
            code = super().main(given, prog_name, complete_var, standalone_mode=False, **extra)
        except click.ClickException as error:
            fail(BlockRobotError("USAGE_INVALID", error.format_message()), as_json=True)
            sys.exit(error.exit_code)
        except click.Abort:
            click.echo("Aborted!", err=True)
            sys.exit(EXIT_FAILED)
        sys.exit(code if isinstance(code, int) else 0)

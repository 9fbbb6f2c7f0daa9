"""Root command group; reports usage errors as JSON too."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from typing import Any

import click

from clients.sdk.terminal.ascii_output import prepare_output
from clients.sdk.terminal.lazy_group import LazyGroup
from clients.sdk.terminal.processes import guard_process
from clients.sdk.terminal.safe_output import safe_streams
from clients.sdk.terminal.terminal import EXIT_FAILED, fail, wants_json
from consensus.errors import BlockRobotError


class RootGroup(LazyGroup):
    """A lazy group with JSON usage errors; `sections` groups commands in its help."""

    def __init__(self, *args: Any, sections: Mapping[str, Sequence[str]], **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.sections = sections

    def command_sections(self) -> Mapping[str, Sequence[str]]:
        return self.sections

    def commands_meant(self, ctx: click.Context) -> list[str]:
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

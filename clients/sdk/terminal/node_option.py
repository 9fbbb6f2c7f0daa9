"""`--node`, before any command."""

from __future__ import annotations

import click

from clients.sdk.terminal.told_nodes import note_typed
from consensus.errors import BlockRobotError

NODE_VARIABLE = "BLOCKROBOT_NODE"


def _note_typed(ctx: click.Context, _: click.Parameter, typed: tuple[str, ...]) -> None:
    if not typed:
        return
    from clients.sdk.given_nodes import read_given  # noqa: PLC0415 - help needs none

    try:
        for text in typed:
            read_given(text)
    except BlockRobotError as error:
        raise click.UsageError(f"--node (or {NODE_VARIABLE}): {error.detail} {error.next_step}", ctx) from None
    note_typed(ctx, typed)


node_option = click.option(
    "--node",
    metavar="[NAME=]URL",
    multiple=True,
    envvar=NODE_VARIABLE,
    expose_value=False,
    callback=_note_typed,
    help="Where a node is reached, to be asked first; may be repeated. Its certificate is checked.",
)

"""`--node`, and the file of nodes beside a genesis file: what a command's clients are told of where nodes are."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from consensus.errors import BlockRobotError

if TYPE_CHECKING:
    from clients.sdk.given_nodes import GivenNode
    from clients.sdk.network_client import NetworkClient

NODE_VARIABLE = "BLOCKROBOT_NODE"
_TYPED_KEY = "blockrobot.typed_nodes"
_FILES_KEY = "blockrobot.nodes_files"
_SAID_KEY = "blockrobot.said_of_nodes"


def _note_typed(ctx: click.Context, _: click.Parameter, typed: tuple[str, ...]) -> None:
    if not typed:
        return
    from clients.sdk.given_nodes import read_given  # noqa: PLC0415 - help needs none

    try:
        ctx.meta[_TYPED_KEY] = [read_given(text) for text in typed]
    except BlockRobotError as error:
        raise click.UsageError(f"--node (or {NODE_VARIABLE}): {error.detail} {error.next_step}", ctx) from None


node_option = click.option(
    "--node",
    metavar="[NAME=]URL",
    multiple=True,
    envvar=NODE_VARIABLE,
    expose_value=False,
    callback=_note_typed,
    help="Where a node is reached, to be asked first; may be repeated. Its certificate is checked.",
)


def note_genesis_place(path: Path, chain_id: bytes) -> None:
    """Clients of this genesis read the file of nodes beside it."""
    context = click.get_current_context(silent=True)
    if context is not None:
        from clients.sdk.given_nodes import NODES_FILE  # noqa: PLC0415 - help needs none

        context.meta.setdefault(_FILES_KEY, {})[chain_id] = path.with_name(NODES_FILE)


async def use_given_nodes(client: NetworkClient) -> None:
    """Tell a client what this command was told; say once on standard error what is not used, and why."""
    context = click.get_current_context(silent=True)
    if context is None:
        return
    from clients.sdk.given_nodes import read_nodes_file  # noqa: PLC0415 - that module is the client's
    from clients.sdk.terminal.terminal import say_error  # noqa: PLC0415 - that reads genesis files, and notes them here

    given: list[GivenNode] = [*context.meta.get(_TYPED_KEY, ())]
    file = context.meta.get(_FILES_KEY, {}).get(client.genesis.chain_id)
    refusals: list[BlockRobotError] = []
    if file is not None and file.exists():
        listed, refusals = read_nodes_file(file)
        given += listed
    if given:
        refusals += await client.use_given(given)
    said: set[str] = context.meta.setdefault(_SAID_KEY, set())
    for words in [say_error(refusal) for refusal in refusals]:
        if words not in said:
            said.add(words)
            click.echo(words, err=True)

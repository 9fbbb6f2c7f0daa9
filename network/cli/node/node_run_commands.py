"""`blockrobot node run`: runs one node in the foreground."""

from __future__ import annotations

import asyncio
import sys
from functools import partial
from pathlib import Path

import click

from clients.sdk.terminal.terminal import FOLDER, ask, can_ask, command_output, console, print_answer
from consensus.errors import BlockRobotError
from network.cli.cluster.cluster_options import network_folder
from network.cli.node.node_answers import NodeRunAnswer
from network.cli.node.node_commands import get_node_config
from network.cluster import Cluster
from network.provisioning.new_node import read_founding_entry, require_certified
from network.provisioning.node_backup import warn_of_restored
from node.config import NodeConfig
from node.main import run_process
from node.node_process import Node


@click.command()
@click.argument("node", required=False)
@click.option("--data-dir", type=FOLDER, help="The node by its data directory.")
@click.option("--dir", "folder", type=click.Path(path_type=Path), default=None, help="The network's folder.")
@click.option(
    "--restored",
    is_flag=True,
    help="The data directory, or its voting journal, comes from a backup or is lost: sign nothing until it is safe.",
)
@click.option("--detach", is_flag=True, help="Leave it running behind this terminal; `blockrobot down` stops it.")
@command_output
def run(
    node: str | None, data_dir: Path | None, folder: Path | None, restored: bool, detach: bool, as_json: bool
) -> None:
    """Run a node until Ctrl-C or SIGTERM. NODE is its data directory, or its name in the local network.

    Every start after a restore from a backup needs --restored once: the node has forgotten what its producer signed
    since, and says nothing until the chain has gone on without it. Of two or three producers that is never: see
    docs/how-to/restore-a-backup.md first.

    Example: blockrobot node run node-2 --restored
    """
    if (node is None) == (data_dir is None):
        raise click.UsageError("Name the node, or its --data-dir.")
    config = get_node_config(node or str(data_dir), folder)
    require_certified(config.data_dir)
    if not config.genesis_path.is_file() and read_founding_entry(config.data_dir) is not None:
        raise BlockRobotError("NETWORK_NOT_FOUNDED", f"The node in {config.data_dir} belongs to no network yet.")
    if restored and (warning := warn_of_restored(config)):
        click.echo(warning, err=True)
        if can_ask():
            ask("Start it all the same?", err=True)
    if detach:
        asyncio.run(_start(config, folder, restored=restored))
        if as_json:
            print_answer(NodeRunAnswer(node=config.name, data_dir=str(config.data_dir)))
        else:
            console.print(f"{config.name} runs. See blockrobot status.")
        return
    sys.exit(run_process(config.data_dir, partial(Node, restored=restored)))


async def _start(config: NodeConfig, folder: Path | None, *, restored: bool) -> None:
    """Raises CLUSTER_ALREADY_RUNNING, CLUSTER_START_FAILED, NODE_STILL_STARTING, NOT_FOUND."""
    cluster = Cluster(network_folder(folder))
    if cluster.config(config.name).data_dir != config.data_dir:
        raise BlockRobotError("NOT_FOUND", f"{config.data_dir} is not of the network in {cluster.folder}.")
    if cluster.is_running(config.name):
        raise BlockRobotError("CLUSTER_ALREADY_RUNNING", f"{config.name} runs already.")
    cluster.start(config.name, restored=restored)
    await cluster.wait_answering(config.name)

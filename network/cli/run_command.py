"""`blockrobot node run`: one node in the foreground, until it is told to stop. Must never start a second one beside it."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path

import click

from network.cli.node_commands import find_node
from node.main import run_process
from node.service import Node


@click.command()
@click.argument("node")
@click.option("--dir", "folder", type=click.Path(path_type=Path), default=None, help="The network's folder.")
@click.option(
    "--restored",
    is_flag=True,
    help="The data directory, or its voting journal, comes from a backup or is lost: be silent until it is safe.",
)
def run(node: str, folder: Path | None, restored: bool) -> None:
    """Run a node until Ctrl-C or SIGTERM. NODE is its data directory, or its name in the local network.

    Every start after a restore from a backup needs --restored once: the node has forgotten what its producer signed
    since, and says nothing until the chain has gone on without it. See docs/how-to/restore-a-backup.md.

    Example: blockrobot node run node-2 --restored
    """
    config = find_node(node, folder)
    sys.exit(run_process(config.data_dir, partial(Node, restored=restored)))

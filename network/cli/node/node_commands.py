"""`blockrobot node`: commands for one node."""

from __future__ import annotations

from pathlib import Path

import click

from clients.sdk.terminal.lazy_group import LazyCommand, LazyGroup
from consensus.errors import BlockRobotError
from network.cli.cluster.cluster_options import network_folder
from network.cluster import Cluster
from node.config import NodeConfig, load_config

_PLACES = {
    "add": LazyCommand(
        "network.cli.node.node_add_commands:add",
        "Add a node to the local network, in one go: for lessons, and for trying things out.",
    ),
    "init": LazyCommand(
        "network.cli.node.node_setup_commands:init",
        "Make the data directory of a node: one that joins a network which runs already, or with --founding a first one.",
    ),
    "directory": LazyCommand(
        "network.cli.node.node_setup_commands:directory",
        "Show who the nodes are by a node's chain; with --out, write it for `node init --directory` elsewhere.",
    ),
    "run": LazyCommand(
        "network.cli.node.node_run_commands:run",
        "Run a node until Ctrl-C or SIGTERM. NODE is its data directory, or its name in the local network.",
    ),
    "snapshot": LazyCommand(
        "network.cli.node.snapshot_commands:snapshot", "Bring a node to a block's state without the blocks before it."
    ),
    "backup": LazyCommand(
        "network.cli.node.backup_commands:backup",
        "Back a node up, while it runs or not: its settings, its ledger, and what it keeps as a custodian.",
    ),
    "restore": LazyCommand(
        "network.cli.node.backup_commands:restore",
        "Make a node of a backup, on a host where nothing of it is left. The ledger is proved first.",
    ),
    "move-custody": LazyCommand(
        "network.cli.node.custody_move_commands:move",
        "Move what a stopped node keeps as a custodian to another store, or its clips to another place. No clip is lost.",
    ),
    "prune": LazyCommand(
        "network.cli.node.ledger_commands:prune",
        "Drop the bodies and receipts of a node's old blocks; headers, certificates, state and audit stay.",
    ),
    "diff": LazyCommand(
        "network.cli.node.ledger_commands:diff",
        "Name the first block and state key on which nodes A and B differ, and the transaction that wrote it.",
    ),
}


@click.group(cls=LazyGroup, places=_PLACES)
def node() -> None:
    """Work on one node: NODE is its data directory, or its name in the local network (see --dir).

    Example: blockrobot node snapshot create node-1 --out backup/node-1
    """


def get_node_config(text: str, folder: Path | None) -> NodeConfig:
    """By data directory or network name. Raises NOT_FOUND, DATA_DIRECTORY_INVALID, CONFIGURATION_INVALID."""
    place = Path(text)
    if place.is_dir():
        return load_config(place.resolve())
    network = network_folder(folder)
    if not (network / "genesis.json").is_file():
        founding = network / "nodes" / text
        if founding.is_dir():
            return load_config(founding.resolve())
        raise BlockRobotError("NOT_FOUND", f"{text} is no data directory, and {network} has no genesis.json.")
    return Cluster(network).config(text)

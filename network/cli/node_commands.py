"""`blockrobot node`: what is done to one node. Must never do work itself: it names the commands and where they live."""

from __future__ import annotations

from pathlib import Path

import click

from consensus.errors import BlockRobotError
from network.cli.cluster_commands import network_folder
from network.cli.lazy_group import LazyGroup
from network.cluster import Cluster
from node.config import CONFIG_FILE, NodeConfig, load_config

_PLACES = {
    "add": ("network.cli.node_add_command", "add"),
    "init": ("network.cli.node_setup_commands", "init"),
    "directory": ("network.cli.node_setup_commands", "directory"),
    "run": ("network.cli.run_command", "run"),
    "snapshot": ("network.cli.snapshot_commands", "snapshot"),
    "prune": ("network.cli.ledger_commands", "prune"),
    "diff": ("network.cli.ledger_commands", "diff"),
}


@click.group(cls=LazyGroup, places=_PLACES)
def node() -> None:
    """Work on one node: NODE is its data directory, or its name in the local network (see --dir).

    Example: blockrobot node snapshot create node-1 --out backup/node-1
    """


def find_node(text: str, folder: Path | None) -> NodeConfig:
    """Return the configuration of the node that a command means: a data directory, or a name in a network's folder.

    Raises NOT_FOUND, DATA_DIRECTORY_INVALID, CONFIGURATION_INVALID.
    """
    place = Path(text)
    if (place / CONFIG_FILE).is_file():
        return load_config(place.resolve())
    if place.is_dir():
        raise BlockRobotError("DATA_DIRECTORY_INVALID", f"There is no {CONFIG_FILE} in {place}.")
    network = network_folder(folder)
    if not (network / "genesis.json").is_file():
        raise BlockRobotError("NOT_FOUND", f"{text} is no data directory, and there is no network in {network}.")
    return Cluster(network).config(text)

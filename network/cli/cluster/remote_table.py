"""The table of nodes that are not in this folder."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

from rich.table import Table
from rich.text import Text

from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import console, show_progress
from consensus.chain.genesis import Genesis
from network.cluster import Cluster
from network.provisioning.node_joining import newest_directory, of_chain
from network.remote_nodes import RemoteNode, ask_remote_nodes
from node.directory.node_directory import content_of_genesis


def ask_elsewhere(cluster: Cluster, *, quiet: bool) -> list[RemoteNode]:
    """Ask the nodes that the chain names and the folder does not hold."""
    genesis = cluster.genesis
    directory = newest_directory(genesis, of_chain(cluster.configs.values(), genesis.chain_id))
    return asyncio.run(ask_remote_nodes(genesis, directory, cluster.names, show_progress(quiet=quiet)))


def ask_from_outside(genesis: Genesis, *, quiet: bool) -> list[RemoteNode]:
    """Ask the nodes of a genesis file, and those that the user named."""
    return asyncio.run(ask_remote_nodes(genesis, content_of_genesis(genesis), (), show_progress(quiet=quiet)))


def print_elsewhere(nodes: Sequence[RemoteNode]) -> None:
    """What each says to everybody; nothing if all nodes are here."""
    if not nodes:
        return
    table = Table(title="Elsewhere, as they prove", title_justify="left", pad_edge=False, collapse_padding=True)
    for column in ("node", "organisation", "state", "final", "address"):
        table.add_column(column, justify="right" if column == "final" else "left", overflow="fold")
    for node in nodes:
        state = Text("answers", style="green") if node.problem is None else Text(node.problem.code, style="red")
        height = "-" if node.finalized_height is None else str(node.finalized_height)
        table.add_row(escape(node.name), escape(node.organisation), state, height, escape(node.api_url))
    console.print(table)
    for node in nodes:
        if node.problem is not None:
            console.print(escape(f"{node.name}: {node.problem.detail} {node.problem.next_step}"), soft_wrap=True)

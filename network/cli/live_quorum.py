"""Looks before a producer goes whether enough of the others are well. Must never take silence for consent: it refuses.

The contracts cannot know which nodes run. What they let pass could still stop the chain at once, and then no further
transaction could mend it.
"""

from __future__ import annotations

import asyncio
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

import click

from clients.sdk.connections import NodeAddress
from clients.sdk.governance import MembershipView, ProducersView, read_producers
from clients.sdk.http import NetworkClient
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from network.cluster import Cluster

ANSWER_TIMEOUT_MS = 3_000
LOOKS_COUNT = 3
LOOK_AGAIN_S = 1.0
"""A node may be busy for a moment; it counts as unwell only if it is so every time."""


def anyway_option(command: Any) -> Any:
    """Add --anyway."""
    text = "Do it even if too few of the producers that would be left answer now."
    return click.option("--anyway", is_flag=True, help=text)(command)


async def _answers(client: NetworkClient, node: NodeAddress) -> bool:
    try:
        await client.ask_node(node, "GET", "/v1/genesis", timeout_ms=ANSWER_TIMEOUT_MS)
    except BlockRobotError:
        return False
    return True


async def find_unwell(client: NetworkClient, folder: Path, names: Iterable[str]) -> list[str]:
    """Return which of these nodes do not answer, or, where they run on this machine, say that they are not ready."""
    addresses = {node.name: node for node in client.nodes}
    asked = [name for name in names if name in addresses]
    answers = await asyncio.gather(*(_answers(client, addresses[name]) for name in asked))
    unwell = {name for name, answer in zip(asked, answers, strict=True) if not answer}
    for row in await Cluster(folder).status():
        if row.name in asked and (row.status is None or not row.status.get("ready")):
            unwell.add(row.name)
    return [name for name in asked if name in unwell]


async def require_live_quorum(
    client: NetworkClient, folder: Path, view: ProducersView, leaving: Collection[bytes]
) -> None:
    """Refuse to let these producers (by key) go if those left over could not make anything final.

    Raises GOVERNANCE_QUORUM_UNWELL.
    """
    seated = [row for row in view.candidates if row.turn is not None]
    left = [row.name for row in seated if row.key not in leaving]
    if not left or len(left) == len(seated):
        return
    needed = len(left) - (len(left) - 1) // 3
    unwell = left
    for look in range(LOOKS_COUNT):
        await asyncio.sleep(LOOK_AGAIN_S if look else 0)
        unwell = await find_unwell(client, folder, unwell)
        if len(left) - len(unwell) >= needed:
            return
    raise BlockRobotError(
        "GOVERNANCE_QUORUM_UNWELL",
        f"{len(left)} producers would be left, and {needed} of them are needed; not well now: {', '.join(unwell)}.",
    )


def leaving_by(kind: str, arguments: Mapping[str, Any], membership: MembershipView) -> set[bytes]:
    """Return the producer keys that a change of membership takes out."""
    name = arguments.get("name")
    if kind not in {"remove_node", "remove_org"}:
        return set()
    gone = [node for node in membership.nodes if name == (node.name if kind == "remove_node" else node.organisation)]
    return {node.producer_key for node in gone if node.producer_key}


async def check_membership_change(
    client: NetworkClient,
    folder: Path,
    reader: PrivateKey,
    membership: MembershipView,
    kind: str,
    arguments: Mapping[str, Any],
) -> None:
    """Look before one stands behind a change that takes nodes out. Raises GOVERNANCE_QUORUM_UNWELL."""
    leaving = leaving_by(kind, arguments, membership)
    if leaving:
        await require_live_quorum(client, folder, await read_producers(client, reader), leaving)

"""Checks, before a producer leaves, that enough others are healthy.

Contracts cannot know which nodes run; an accepted change could stop the chain beyond repair by transaction.
"""

from __future__ import annotations

import asyncio
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from clients.sdk.chain.governance import MembershipView, ProducersView, ProvedCandidate, read_producers
from clients.sdk.connections import NodeAddress
from clients.sdk.network_client import NetworkClient
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from network.cluster import Cluster

ANSWER_TIMEOUT_MS = 3_000
LOOKS_COUNT = 3
TOLERANT_MIN_COUNT = 4
"""Where fewer would be left, the contract keeps the suspended on their seats."""
LOOK_AGAIN_S = 1.0
"""A node may be busy for a moment; it counts as unwell only if it is so every time."""


def anyway_option(command: Any) -> Any:
    text = "Do it even if too few of the producers that would be left answer now."
    return click.option("--anyway", is_flag=True, help=text)(command)


async def _answers(client: NetworkClient, node: NodeAddress) -> bool:
    try:
        await client.ask_node(node, "GET", "/v1/genesis", timeout_ms=ANSWER_TIMEOUT_MS)
    except BlockRobotError:
        return False
    return True


async def find_unwell(client: NetworkClient, folder: Path, names: Iterable[str]) -> list[str]:
    """Nodes that do not answer or, if local, are not ready."""
    addresses = {node.name: node for node in client.nodes}
    asked = [name for name in names if name in addresses]
    answers = await asyncio.gather(*(_answers(client, addresses[name]) for name in asked))
    unwell = {name for name, answer in zip(asked, answers, strict=True) if not answer}
    for row in await Cluster(folder).status():
        if row.name in asked and (row.status is None or not row.status.get("ready")):
            unwell.add(row.name)
    return [name for name in asked if name in unwell]


def seats_after(
    view: ProducersView,
    *,
    leaving: Collection[bytes] = (),
    leaving_organisation: str = "",
    withdrawn: tuple[bytes, str] | None = None,
    maximum: int | None = None,
) -> list[ProvedCandidate]:
    """By the election contract's rules. `withdrawn` is a candidate key and the organisation withdrawing its vote (empty:
    any). Waiting newcomers are excluded: they may be unready.
    """
    most = view.max_producers if maximum is None else maximum
    ranked = []
    seated = sorted((row for row in view.candidates if row.turn is not None), key=lambda row: row.turn or 0)
    for row in seated:
        votes = set(row.votes) - {leaving_organisation}
        if withdrawn is not None and row.key == withdrawn[0]:
            votes = votes - {withdrawn[1]} if withdrawn[1] else set(sorted(votes)[1:])
        if row.status == "producing" and row.key not in leaving and votes:
            ranked.append((-len(votes), row.since_ms, row.key))
    chosen = {key for _, _, key in sorted(ranked)[:most]}
    if len(chosen) < TOLERANT_MIN_COUNT:
        kept = [row.key for row in seated if row.status == "suspended" and row.key not in leaving]
        chosen.update(kept[: most - len(chosen)])
    return [row for row in seated if row.key in chosen]


async def require_live_quorum(
    client: NetworkClient,
    folder: Path,
    view: ProducersView,
    after: Sequence[ProvedCandidate],
    silenced: Collection[str] = (),
) -> None:
    """`silenced` nodes keep a seat but cannot sign until given a new key. Raises GOVERNANCE_QUORUM_AT_RISK."""
    seated = [row for row in view.candidates if row.turn is not None]
    left = [row.name for row in after]
    mute = [name for name in left if name in silenced]
    if not left or (len(left) == len(seated) and not mute):
        return
    needed = len(left) - (len(left) - 1) // 3
    unwell = [name for name in left if name not in mute]
    for look in range(LOOKS_COUNT):
        await asyncio.sleep(LOOK_AGAIN_S if look else 0)
        unwell = await find_unwell(client, folder, unwell)
        if len(left) - len(mute) - len(unwell) >= needed:
            return
    missing = [*(f"{name} (until it has its new key)" for name in mute), *unwell]
    raise BlockRobotError(
        "GOVERNANCE_QUORUM_AT_RISK",
        f"{len(left)} producers would be left, and {needed} of them are needed; not well now: {', '.join(missing)}.",
    )


async def check_membership_change(
    client: NetworkClient,
    folder: Path,
    reader: PrivateKey,
    membership: MembershipView,
    kind: str,
    arguments: Mapping[str, Any],
) -> None:
    """Does it remove or silence producers? Raises GOVERNANCE_QUORUM_AT_RISK."""
    if kind not in {"remove_node", "remove_org", "rekey_producer"}:
        return
    view = await read_producers(client, reader)
    if kind == "rekey_producer":
        await require_live_quorum(client, folder, view, seats_after(view), {arguments["node"]})
        return
    name = arguments["name"]
    gone = [node for node in membership.nodes if name == (node.name if kind == "remove_node" else node.organisation)]
    leaving = {node.producer_key for node in gone if node.producer_key}
    leaving_organisation = name if kind == "remove_org" else ""
    after = seats_after(view, leaving=leaving, leaving_organisation=leaving_organisation)
    await require_live_quorum(client, folder, view, after)


async def check_setting(client: NetworkClient, folder: Path, reader: PrivateKey, name: str, value: int | str) -> None:
    """A lower number of seats. Raises GOVERNANCE_QUORUM_AT_RISK."""
    if name == "max_producers" and isinstance(value, int) and value > 0:
        view = await read_producers(client, reader)
        await require_live_quorum(client, folder, view, seats_after(view, maximum=value))

"""Facts one node cannot vouch for: that state is newest, that membership ended."""

from __future__ import annotations

import asyncio
from typing import Any, Protocol

from clients.sdk.connections import NodeAddress
from clients.sdk.known_nodes import read_active_nodes
from clients.sdk.node_answers import NOT_TAKING_PART
from clients.sdk.proof_checks import ProvedState
from consensus.chain.block import Header
from consensus.chain.genesis import Genesis
from consensus.chain.light_client import LightClient
from consensus.chain.schedule import Schedule
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey

_TURNED_AWAY = frozenset({"SESSION_REFUSED", "SENDER_NOT_ADMITTED"})
_SERVES_NOBODY = NOT_TAKING_PART | {"NODE_UNREACHABLE", "NODE_ADDRESS_WRONG"}


class HeaderClient(Protocol):
    """The part of a `NetworkClient` that a quorum needs."""

    genesis: Genesis
    light_client: LightClient

    @property
    def nodes(self) -> tuple[NodeAddress, ...]: ...

    async def node_header(self, node: NodeAddress, key: PrivateKey) -> Header:
        """The newest that this node proves final; pinned."""

    async def state_values(self, keys: Any, key: PrivateKey) -> ProvedState:
        """Return up to 128 proved values."""


async def confirm_with_quorum(client: HeaderClient, key: PrivateKey) -> bool:
    """Did a quorum of producers answer with headers not older than the pin?"""
    seats = await _seats(client, key)
    epoch = client.light_client.epoch
    missing = {seat for seat in epoch.producers if seat in seats.values()}
    needed, heard = Schedule.of(epoch).quorum, set[bytes]()
    if len(missing) < needed:
        return False

    async def ask(node: NodeAddress) -> bytes | None:
        try:
            await client.node_header(node, key)
        except BlockRobotError:
            return None
        return seats[node.name]

    asked = [asyncio.create_task(ask(node)) for node in client.nodes if seats.get(node.name) in missing]
    try:
        for answer in asyncio.as_completed(asked):
            seat = await answer
            if seat is not None:
                heard.add(seat)
            if len(heard) >= needed:
                break
    finally:
        for task in asked:
            task.cancel()
        await asyncio.gather(*asked, return_exceptions=True)
    return len(heard) >= needed and client.light_client.epoch.number == epoch.number


async def require_quorum(client: HeaderClient, key: PrivateKey) -> None:
    """Require state at least as new as a quorum knows; against nodes that serve old state. Raises QUORUM_UNREACHABLE."""
    if not await confirm_with_quorum(client, key):
        raise BlockRobotError("QUORUM_UNREACHABLE")


async def is_rejected_by_network(client: HeaderClient, key: PrivateKey) -> bool:
    """No node serves this key, and more than may be faulty reject it."""

    async def ask(node: NodeAddress) -> str:
        try:
            await client.node_header(node, key)
        except BlockRobotError as error:
            return error.code
        return ""

    codes = await asyncio.gather(*(ask(node) for node in client.nodes))
    refusals = sum(code in _TURNED_AWAY for code in codes)
    is_served = any(code not in _TURNED_AWAY | _SERVES_NOBODY for code in codes)
    return not is_served and refusals > Schedule.of(client.light_client.epoch).faults_tolerated


async def _seats(client: HeaderClient, key: PrivateKey) -> dict[str, bytes]:
    height, rows, _ = await read_active_nodes(lambda keys: client.state_values(keys, key))
    nodes = rows if height else client.genesis.nodes
    return {node.name: node.producer_key for node in nodes if node.producer_key}

"""Nodes that lie in no folder here: asked over TLS what their interface says to everybody."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Collection
from typing import Annotated

import msgspec

from clients.sdk.connections import CONNECT_TIMEOUT_MS, NodeAddress, check_address
from clients.sdk.given_nodes import use_given_nodes
from clients.sdk.known_nodes import NODES_MAX_COUNT, KnownNode, KnownNodes
from clients.sdk.network_client import NetworkClient
from clients.sdk.node_answers import read_answer
from clients.sdk.proof_checks import ProofVerifier, ProvedState
from clients.sdk.terminal.json_answers import Answer, Height, Problem, TimeMs, doc
from clients.sdk.terminal.terminal import problem_json
from clients.sdk.trust_pin import write_pin
from consensus.api_documents import EpochsAnswer, ProofsAnswer, ProofsRequest
from consensus.chain.genesis import Genesis
from consensus.chain.light_client import LightClient
from consensus.errors import BlockRobotError
from consensus.state.consent import NOTICE
from node.directory.node_directory import DirectoryContent, DirectoryNode

ASK_REMOTE_TIMEOUT_MS = CONNECT_TIMEOUT_MS
"""For each request: a node on the other side of the world answers in a tenth of it."""


class RemoteNode(Answer, frozen=True, kw_only=True):
    """A node of the network that is not in this folder."""

    name: Annotated[str, doc("The node")]
    organisation: Annotated[str, doc("Whose node it is")]
    api_url: Annotated[str, doc("Where it was asked")]
    custodian: Annotated[bool, doc("Whether it keeps clips")]
    finalized_height: Annotated[Height | None, doc("Its newest final block, as it proves; null if it did not")]
    finalized_ms: Annotated[TimeMs | None, doc("The time of that block; null if it did not prove one")]
    answered_in_ms: Annotated[int | None, doc("How long the proof took; null if there is none")]
    problem: Annotated[Problem | None, doc("Why there is none; null if there is one")]


async def ask_remote_nodes(genesis: Genesis, directory: DirectoryContent, here: Collection[str]) -> list[RemoteNode]:
    """All active nodes but those of `here`. What is proved is proved anew from the genesis, by each node alone."""
    others = [node for name, node in directory.active.items() if name not in here][:NODES_MAX_COUNT]
    usable = [node for node in others if _is_usable(node)]
    if not usable:
        return [_without_answer(node, BlockRobotError("NODE_ADDRESS_UNUSABLE")) for node in others]
    known = [
        KnownNode(
            node.name,
            node.api_url,
            bool(node.custodian_key),
            directory.organisations[node.organisation].ca_certificate,
        )
        for node in usable
    ]
    pin = write_pin(LightClient(genesis), KnownNodes(directory.height, tuple(known)))
    async with NetworkClient(genesis, pinned=pin) as client:
        await use_given_nodes(client, genesis.chain_id)
        addresses = {node.name: node for node in client.nodes}
        asked = [_ask(client, node, addresses.get(node.name)) for node in others]
        return list(await asyncio.gather(*asked))


def _is_usable(node: DirectoryNode) -> bool:
    try:
        check_address(NodeAddress(node.name, node.api_url))
    except BlockRobotError:
        return False
    return True


def _without_answer(node: DirectoryNode, error: BlockRobotError, url: str = "") -> RemoteNode:
    return RemoteNode(
        name=node.name,
        organisation=node.organisation,
        api_url=url or node.api_url,
        custodian=bool(node.custodian_key),
        finalized_height=None,
        finalized_ms=None,
        answered_in_ms=None,
        problem=Problem(**problem_json(error)),
    )


async def _ask(client: NetworkClient, node: DirectoryNode, address: NodeAddress | None) -> RemoteNode:
    if address is None:
        return _without_answer(node, BlockRobotError("NODE_ADDRESS_UNUSABLE"))
    started_s = time.monotonic()
    try:
        proved = await _prove(client, node.organisation, address)
    except BlockRobotError as error:
        return _without_answer(node, error, address.url)
    return RemoteNode(
        name=node.name,
        organisation=node.organisation,
        api_url=address.url,
        custodian=bool(node.custodian_key),
        finalized_height=proved.height,
        finalized_ms=proved.timestamp_ms,
        answered_in_ms=round((time.monotonic() - started_s) * 1000),
        problem=None,
    )


async def _prove(client: NetworkClient, organisation: str, address: NodeAddress) -> ProvedState:
    """What a notice's proof shows on the way: the newest final block. Raises NODE_UNREACHABLE, PROOF_INVALID etc."""
    verifier = ProofVerifier(client.genesis, LightClient(client.genesis))
    key = NOTICE.key(organisation)
    body = msgspec.json.encode(ProofsRequest([key.hex()]))
    while True:
        content = await client.ask_node(
            address, "POST", "/v1/notice-proofs", body=body, timeout_ms=ASK_REMOTE_TIMEOUT_MS
        )
        try:
            return verifier.values(read_answer(content, ProofsAnswer), [key])
        except BlockRobotError as error:
            if error.code != "PROOF_OTHER_EPOCH":
                raise
        query = {"after": verifier.epoch}
        content = await client.ask_node(address, "GET", "/v1/epochs", query=query, timeout_ms=ASK_REMOTE_TIMEOUT_MS)
        if not verifier.follow(read_answer(content, EpochsAnswer)):
            raise BlockRobotError("PROOF_OTHER_EPOCH")

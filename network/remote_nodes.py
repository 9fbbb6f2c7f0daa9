"""Nodes that lie in no folder here: asked over TLS what their interface says to everybody."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated

import msgspec

from clients.sdk.connections import CONNECT_TIMEOUT_MS, NodeAddress, check_address
from clients.sdk.given_nodes import GivenNode, read_claim, use_given_nodes
from clients.sdk.known_nodes import NODES_MAX_COUNT, KnownNode, KnownNodes
from clients.sdk.network_client import NetworkClient
from clients.sdk.node_answers import read_answer
from clients.sdk.node_hints import HINTS
from clients.sdk.proof_checks import ProofVerifier
from clients.sdk.terminal.json_answers import Answer, Height, Problem, TimeMs, doc
from clients.sdk.terminal.terminal import problem_json
from clients.sdk.trust_pin import write_pin
from consensus.api_documents import EpochsAnswer, ProofsAnswer, ProofsRequest
from consensus.chain.block import Header
from consensus.chain.genesis import Genesis
from consensus.chain.light_client import LightClient
from consensus.errors import BlockRobotError
from consensus.state.consent import NOTICE
from node.directory.node_directory import DirectoryContent, DirectoryNode

ASK_REMOTE_TIMEOUT_MS = CONNECT_TIMEOUT_MS
"""For each request: a node on the other side of the world answers in a tenth of it."""
ASK_ALL_REMOTE_MAX_S = 60.0
"""For all nodes and requests together: a chain of many epochs is proved from its genesis."""
OnProgress = Callable[[str, int, int], None]
"""Told what is being done, how much is done, and of how much."""


class RemoteNode(Answer, frozen=True, kw_only=True):
    """A node of the network that is not in this folder."""

    name: Annotated[str, doc("The node")]
    organisation: Annotated[str, doc("Whose node it is")]
    api_url: Annotated[str, doc("Where it was asked")]
    custodian: Annotated[
        bool | None, doc("Whether it keeps clips; null if it was named by `--node` and is not known here")
    ]
    finalized_height: Annotated[Height | None, doc("Its newest final block, as it proves; null if it did not")]
    finalized_ms: Annotated[TimeMs | None, doc("The time of that block; null if it did not prove one")]
    answered_in_ms: Annotated[int | None, doc("How long the proof took; null if there is none")]
    problem: Annotated[Problem | None, doc("Why there is none; null if there is one")]


async def ask_remote_nodes(
    genesis: Genesis,
    directory: DirectoryContent,
    here: Collection[str],
    progress: OnProgress = lambda _what, _done, _of: None,
) -> list[RemoteNode]:
    """All active nodes but those of `here`, and those that the user named. Each proves its newest final block from the
    genesis on; an epoch that one of them proved is not proved again of the others.
    """
    others = [node for name, node in directory.active.items() if name not in here][:NODES_MAX_COUNT]
    given = any(HINTS.read(genesis.chain_id))
    usable = [node for node in (directory.active.values() if given else others) if _is_usable(node)]
    if not usable and not given:
        unusable = BlockRobotError("NODE_ADDRESS_UNUSABLE")
        return [_Asked.listed(node).answered(None, unusable) for node in others]
    known = [
        KnownNode(
            node.name,
            node.api_url,
            directory.organisations[node.organisation].ca_certificate,
        )
        for node in usable[:NODES_MAX_COUNT]
    ]
    pin = write_pin(LightClient(genesis), KnownNodes(directory.height, tuple(known), (), 0))
    deadline_s = asyncio.get_running_loop().time() + ASK_ALL_REMOTE_MAX_S
    async with NetworkClient(genesis, pinned=pin) as client:
        await use_given_nodes(client, genesis.chain_id)
        addresses = {node.name: node for node in client.nodes}
        owners = {each.ca_certificate: name for name, each in directory.organisations.items()}
        asked = [(_Asked.listed(node), addresses.get(node.name)) for node in others]
        asked += [
            (_Asked(node.name, owners.get(node.ca_certificate, ""), node.url, None), node)
            for node in client.unlisted
            if node.name not in {*here, *directory.active}
        ]
        asking = _Asking(client, directory, deadline_s, partial(progress, "Asking nodes elsewhere"), len(asked))
        return list(await asyncio.gather(*(asking.ask(*each) for each in asked)))


def _is_usable(node: DirectoryNode) -> bool:
    try:
        check_address(NodeAddress(node.name, node.api_url))
    except BlockRobotError:
        return False
    return True


@dataclass(frozen=True, slots=True)
class _Asked:
    """A node, as it is known before it answers."""

    name: str
    organisation: str
    api_url: str
    custodian: bool | None

    @classmethod
    def listed(cls, node: DirectoryNode) -> _Asked:
        return cls(node.name, node.organisation, node.api_url, bool(node.custodian_key))

    def answered(self, proved: tuple[Header, int] | None, refusal: BlockRobotError) -> RemoteNode:
        """By its newest final block and how long the proof of it took (ms), or by why there is none."""
        return RemoteNode(
            name=self.name,
            organisation=self.organisation,
            api_url=self.api_url,
            custodian=self.custodian,
            finalized_height=None if proved is None else proved[0].height,
            finalized_ms=None if proved is None else proved[0].timestamp_ms,
            answered_in_ms=None if proved is None else proved[1],
            problem=Problem(**problem_json(refusal)) if proved is None else None,
        )


class _Asking:
    """Asks nodes side by side; what one proves of the chain's epochs holds for all."""

    def __init__(
        self,
        client: NetworkClient,
        directory: DirectoryContent,
        deadline_s: float,
        progress: Callable[[int, int], None],
        count: int,
    ) -> None:
        self._client, self._names, self._deadline_s = client, frozenset(directory.nodes), deadline_s
        self._verifier = ProofVerifier(client.genesis, LightClient(client.genesis))
        self._proved: dict[int, Header] = {}
        self._key = NOTICE.key(next((each.name for each in client.genesis.organisations), ""))
        self._progress, self._done, self._count = progress, 0, count
        if count:
            progress(0, count)

    async def ask(self, node: _Asked, address: NodeAddress | None) -> RemoteNode:
        started_s = time.monotonic()
        proved, refusal = None, BlockRobotError("NODE_ADDRESS_UNUSABLE")
        if address is not None:
            node = replace(node, api_url=address.url)
            try:
                async with asyncio.timeout_at(self._deadline_s):
                    proved = await self._prove(address), round((time.monotonic() - started_s) * 1000)
                    await self._require_no_other(address)
            except BlockRobotError as error:
                proved, refusal = None, error
            except TimeoutError:
                proved, sentence = None, f"Node {node.name} proved no final block within {ASK_ALL_REMOTE_MAX_S:.0f} s."
                refusal = BlockRobotError("NODE_UNREACHABLE", sentence)
        self._done += 1
        self._progress(self._done, self._count)
        return node.answered(proved, refusal)

    async def _require_no_other(self, address: NodeAddress) -> None:
        """A proxy there may have a name of its own, or none; another known node may not. Raises NODE_ADDRESS_WRONG."""
        if address.is_given or not address.url.startswith("https:"):
            return
        given = GivenNode(address.url)
        try:
            shown = (await read_claim(given)).name
        except BlockRobotError:
            return
        if shown != address.name and shown in self._names:
            sentence = f"By its certificate, {given.place} is {shown!r}, not {address.name!r}."
            raise BlockRobotError("NODE_ADDRESS_WRONG", sentence)

    async def _prove(self, address: NodeAddress) -> Header:
        """The newest final block, which stands in a notice's proof.

        Raises NODE_UNREACHABLE, PROOF_INVALID, GENESIS_DIFFERS etc.
        """
        body = msgspec.json.encode(ProofsRequest([self._key.hex()]))
        while True:
            content = await self._client.ask_node(
                address, "POST", "/v1/notice-proofs", body=body, timeout_ms=ASK_REMOTE_TIMEOUT_MS
            )
            answer = read_answer(content, ProofsAnswer)
            if answer.finality is None and not await self._client.is_of_this_chain(address):
                raise BlockRobotError(
                    "GENESIS_DIFFERS", f"{address.name} runs by another genesis file than the one here."
                )
            try:
                header = self._verifier.final_header(answer.finality)
            except BlockRobotError as error:
                if error.code != "PROOF_OTHER_EPOCH":
                    raise
            else:
                if self._proved.setdefault(header.height, header) != header:
                    raise BlockRobotError("PROOF_INVALID", "Another node proves another final block of this height.")
                return header
            before = self._verifier.epoch
            content = await self._client.ask_node(
                address, "GET", "/v1/epochs", query={"after": before}, timeout_ms=ASK_REMOTE_TIMEOUT_MS
            )
            if not self._verifier.follow(read_answer(content, EpochsAnswer)) and self._verifier.epoch == before:
                raise BlockRobotError("PROOF_OTHER_EPOCH")

"""`blockrobot node add`: one more local node, from keys to seat."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import click

from clients.sdk.chain.governance import MembershipView
from clients.sdk.network_client import open_pinned_client
from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import command_output, console, print_answer
from clients.sdk.trust_pin import PIN_FILE
from consensus.chain.genesis import NodeEntry
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from network.cli.cluster.cluster_options import folder_option, network_folder
from network.cli.governance.governance_signer import admin_keys, read_private_key
from network.cli.node.node_answers import NodeAddAnswer, NodeAddStep
from network.cluster import Cluster
from network.provisioning.certificate_authority import AUTHORITY_KEY_FILE
from network.provisioning.new_node import NewNode
from network.provisioning.node_adding import NodeAddition, Step
from network.provisioning.node_certificates import get_authority
from network.provisioning.node_joining import init_node, newest_directory, next_base_port, of_chain
from node.config import LOOPBACK, load_config
from node.directory.node_directory import DirectoryContent


@click.command("add")
@click.argument("name", required=False)
@click.option("--organisation", help="Whose node it is; else whoever of those on this machine has the fewest nodes.")
@click.option("--producer", "is_producer", is_flag=True, help="Vote it in as a producer, too, and wait for its seat.")
@click.option("--custodian", "is_custodian", is_flag=True, help="It keeps off-chain data too.")
@click.option("--base-port", type=click.IntRange(1, 65_533), help="The first of its three ports; else the next free.")
@folder_option
@command_output
def add(
    name: str | None,
    organisation: str | None,
    is_producer: bool,
    is_custodian: bool,
    base_port: int | None,
    folder: Path | None,
    as_json: bool,
) -> None:
    """Add a node to the local network, in one go: for lessons, and for trying things out.

    It does what `node init`, `org propose add-node`, `org approve`, `node run --detach`, and with --producer `producer
    propose` and `producer approve` do, speaking for every organisation whose admin's key lies on this machine, and
    prints each step. Where several parties govern, each says its own part itself.

    Example: blockrobot node add --producer
    """
    place = network_folder(folder)
    cluster = Cluster(place)
    voices = {owner: read_private_key(path) for owner, path in admin_keys(place).items()}
    if not voices:
        raise BlockRobotError("ORGANISATION_KEY_NOT_FOUND", f"There is no admin's key in {place / 'organisations'}.")
    steps: list[Step] = []

    def on_progress(step: Step) -> None:
        steps.append(step)
        if not as_json:
            console.print(f"  {len(steps)}. {escape(step.sentence())}", soft_wrap=True)

    wanted = _NewNode(name, organisation, is_producer, is_custodian, base_port)
    added, growth = asyncio.run(_add(cluster, voices, wanted, on_progress))
    if as_json:
        done = [NodeAddStep(who=step.who, what=step.what, height=step.height) for step in steps]
        answer = NodeAddAnswer(
            node=added.name, organisation=added.organisation, steps=done, waiting_for=growth.waiting_for
        )
        print_answer(answer)
        return
    for command in growth.waiting_for:
        console.print(f"Next step: {escape(command)}", soft_wrap=True)
    if not growth.waiting_for:
        console.print(f"{escape(added.name)} takes part. See blockrobot status, blockrobot producer list.")


@dataclass(frozen=True, slots=True)
class _NewNode:
    name: str | None
    organisation: str | None
    is_producer: bool
    is_custodian: bool
    base_port: int | None


async def _add(
    cluster: Cluster, voices: dict[str, PrivateKey], wanted: _NewNode, on_progress: Callable[[Step], None]
) -> tuple[NodeEntry, NodeAddition]:
    async with open_pinned_client(cluster.genesis, cluster.folder / PIN_FILE) as client:
        growth = NodeAddition(client, voices, on_progress)
        membership = await growth.begin()
        entry = _make(cluster, membership, growth, wanted)
        home = cluster.folder / "nodes" / entry.name
        on_progress(Step("", f"node init {entry.name} --organisation {entry.organisation}: {home}"))
        fields = {field: getattr(entry, field) for field in NodeEntry.__struct_fields__}
        is_agreed = await growth.agree("add_node", fields, entry.organisation)
        cluster.configs[entry.name] = load_config(home)
        cluster.start(entry.name)
        await cluster.wait_answering(entry.name)
        if not is_agreed:
            on_progress(Step("", f"node run {entry.name}: it runs, and waits for the organisations"))
            return entry, growth
        await cluster.wait_ready([entry.name])
        on_progress(Step("", f"node run {entry.name}: it has fetched the chain and follows it"))
        if wanted.is_producer and await growth.vote_in(entry.name, entry.producer_key, entry.organisation):
            await growth.wait_seated(entry.name, entry.producer_key)
        return entry, growth


def _make(cluster: Cluster, membership: MembershipView, growth: NodeAddition, wanted: _NewNode) -> NodeEntry:
    """Raises AUTHORITY_NOT_HERE, NODE_EXISTS, NOT_FOUND."""
    configs = list(cluster.configs.values())
    known = newest_directory(cluster.genesis, of_chain(configs, cluster.genesis.chain_id))
    owner = wanted.organisation or _smallest(cluster.folder, membership, list(growth.voices))
    name = wanted.name or _free_name(cluster, known, membership)
    newcomer = NewNode(
        name=name,
        organisation=owner,
        host=LOOPBACK,
        base_port=wanted.base_port or next_base_port(known, configs),
        is_custodian=wanted.is_custodian,
        faults=any(config.faults_enabled for config in configs),
    )
    authority = get_authority(cluster.folder, owner)
    return init_node(cluster.folder / "nodes" / name, newcomer, cluster.genesis, authority, known)


def _free_name(cluster: Cluster, known: DirectoryContent, membership: MembershipView) -> str:
    taken = {*known.nodes, *cluster.names, *(node.name for node in membership.nodes)}
    return next(name for number in itertools.count(1) if (name := f"node-{number}") not in taken)


def _smallest(folder: Path, membership: MembershipView, voices: list[str]) -> str:
    """Raises AUTHORITY_NOT_HERE."""
    able = [name for name in voices if (folder / "organisations" / name / AUTHORITY_KEY_FILE).is_file()]
    if not able:
        raise BlockRobotError(
            "AUTHORITY_NOT_HERE", f"No organisation's {AUTHORITY_KEY_FILE} is in {folder / 'organisations'}."
        )
    counts = {name: sum(node.organisation == name for node in membership.nodes) for name in able}
    return min(able, key=lambda name: counts[name])

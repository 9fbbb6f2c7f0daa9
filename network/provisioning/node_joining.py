"""Creates a node for a running network: data directory, and entry for approval."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from clients.sdk.node_places import canonical_host
from consensus.chain.genesis import Genesis, NodeEntry, genesis_to_json
from consensus.errors import BlockRobotError
from network.provisioning.certificate_authority import Authority
from network.provisioning.network_layout import FIRST_PORT, PORTS_PER_NODE
from network.provisioning.new_node import NewNode, create_node, is_name
from node.config import NodeConfig, load_genesis
from node.directory.directory_file import DIRECTORY_FILE, encode_directory
from node.directory.node_directory import DirectoryContent, content_of_genesis, read_content
from node.storage.lmdb_reader import LedgerFile


def read_directory_of(config: NodeConfig) -> DirectoryContent | None:
    """From a local node's ledger, running or not; None if absent.

    Raises STORAGE_DAMAGED, STORAGE_BUSY, DATA_DIRECTORY_INVALID.
    """
    with LedgerFile(config.ledger_dir) as ledger, ledger.snapshot() as snapshot:
        position = snapshot.position
        return None if position is None else read_content(snapshot, position.height)


def check_asked(
    name: str, hosts: Iterable[str], organisation: str, known: DirectoryContent | None, expected: str | None
) -> None:
    """Whether an organisation's authority may certify a node of this name at these hosts. Raises FILE_UNUSABLE.

    `expected`: whose request it is to be. A name among the hosts that is another node's would let it answer as that.
    """
    nodes = {} if known is None else known.nodes
    owner = nodes[name].organisation if name in nodes else organisation
    false = sorted(host for host in hosts if _canonical(host) in {"", *nodes} - {name})
    if not is_name(name):
        detail = f"The request names {name!r}, which is no name of a node."
    elif expected not in {None, name}:
        detail = f"The request is of {name!r}, not of {expected!r}."
    elif owner != organisation:
        detail = f"The request is of {name!r}, which is a node of {owner!r}."
    elif false:
        detail = f"The request of {name!r} names {false[0]!r} besides, which is no address of its own."
    else:
        return
    raise BlockRobotError("FILE_UNUSABLE", detail)


def _canonical(host: str) -> str:
    """Empty if it is no host's name or address."""
    try:
        return canonical_host(host)
    except ValueError:
        return ""


def newest_directory(genesis: Genesis, configs: Iterable[NodeConfig]) -> DirectoryContent:
    newest = content_of_genesis(genesis)
    for config in configs:
        try:
            content = read_directory_of(config)
        except BlockRobotError:
            continue
        if content is not None and content.height > newest.height:
            newest = content
    return newest


def of_chain(configs: Iterable[NodeConfig], chain_id: bytes) -> list[NodeConfig]:
    """Skips unreadable genesis files."""
    found = []
    for config in configs:
        try:
            own = load_genesis(config).chain_id
        except (BlockRobotError, OSError):
            continue
        if own == chain_id:
            found.append(config)
    return found


def organisation_of(config: NodeConfig, configs: Iterable[NodeConfig]) -> str:
    """By configuration, genesis or local ledgers. Raises NOT_FOUND."""
    if config.organisation:
        return config.organisation
    node = newest_directory(load_genesis(config), configs).nodes.get(config.name)
    if node is None:
        raise BlockRobotError("NOT_FOUND", f"Nobody here knows whose node {config.name} is.")
    return node.organisation


def next_base_port(directory: DirectoryContent, configs: Iterable[NodeConfig]) -> int:
    used = [node.p2p_port for node in directory.nodes.values()] + [config.p2p_port for config in configs]
    return max(used, default=FIRST_PORT - PORTS_PER_NODE) + PORTS_PER_NODE


def check_newcomer(new: NewNode, directory: DirectoryContent) -> None:
    """Check early as the network would. Raises NODE_EXISTS, ORGANISATION_NOT_ADMITTED, CONFIGURATION_INVALID."""
    new.check()
    if new.name in directory.nodes:
        raise BlockRobotError("NODE_EXISTS", f"There is, or was, a node {new.name!r} in this network.")
    organisation = directory.organisations.get(new.organisation)
    if organisation is None or not organisation.is_active:
        known = ", ".join(item.name for item in directory.organisations.values() if item.is_active)
        detail = f"There is no organisation {new.organisation!r} at height {directory.height}; there are {known}."
        raise BlockRobotError("ORGANISATION_NOT_ADMITTED", detail)


def init_node(
    folder: Path, new: NewNode, genesis: Genesis, authority: Authority, directory: DirectoryContent
) -> NodeEntry:
    """Return its entry for approval. Raises NODE_EXISTS, ORGANISATION_NOT_ADMITTED, CONFIGURATION_INVALID."""
    check_newcomer(new, directory)
    files = {"genesis.json": genesis_to_json(genesis).encode()}
    if directory.height > 0:
        files[DIRECTORY_FILE] = encode_directory(genesis.chain_id, directory)
    return create_node(folder, new, authority, files=files, organisation=new.organisation)

"""Creates a node for a running network: data directory, and entry for approval."""

from __future__ import annotations

import ipaddress
import json
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import urlsplit

from clients.sdk.connections import NodeAddress, check_address
from consensus.chain.genesis import Genesis, NodeEntry, genesis_to_json, prove_possession
from consensus.errors import BlockRobotError
from network.provisioning.certificate_authority import Authority, write_secret
from network.provisioning.network_layout import (
    PORTS_PER_NODE,
    Listening,
    NodeKeys,
    check_name,
    create_node,
    new_key,
    store_uri_of,
)
from node.config import LOOPBACK, NodeConfig, load_genesis
from node.directory.directory_file import DIRECTORY_FILE, encode_directory
from node.directory.node_directory import DirectoryContent, content_of_genesis, read_content
from node.storage.lmdb_reader import LedgerFile
from pages.listening import is_loopback

ENTRY_FILE = "node-entry.json"
_PORT_MAX = 65_535
_EVERYWHERE = frozenset({"0.0.0.0", "::"})  # noqa: S104 - refused
_HOST = re.compile(r"[a-z0-9.:_-]{1,253}")


def read_directory_of(config: NodeConfig) -> DirectoryContent | None:
    """From a local node's ledger, running or not; None if absent.

    Raises STORAGE_DAMAGED, STORAGE_BUSY, DATA_DIRECTORY_INVALID.
    """
    with LedgerFile(config.ledger_dir) as ledger, ledger.snapshot() as snapshot:
        position = snapshot.position
        return None if position is None else read_content(snapshot, position.height)


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


@dataclass(frozen=True, slots=True)
class JoiningNode:
    """A new node's parameters. It listens at `bind` (else `host`), on ports `base_port` to `base_port` + 2.

    Others reach it at `host` and `p2p_port` (else `base_port`), its clients at `api_url` (else `host`, the port after it).
    """

    name: str
    organisation: str
    host: str
    base_port: int
    store: str = "sqlite"
    is_custodian: bool = False
    faults: bool = False
    api_url: str = ""
    bind: str = ""
    api_bind: str = ""
    p2p_port: int = 0

    @property
    def reached_at(self) -> tuple[str, int, str]:
        """Host and port for peers, address for clients."""
        port = self.p2p_port or self.base_port
        host = f"[{self.host}]" if ":" in self.host else self.host
        scheme = "http" if is_loopback(self.host) and is_loopback(self.bind or self.host) else "https"
        return self.host, port, self.api_url or f"{scheme}://{host}:{port + 1}"

    @property
    def listening(self) -> Listening:
        """Clients are served where peers are, but on loopback if a proxy has to stand before that."""
        bind = self.bind or self.host
        plain = self.reached_at[2].startswith("http:")
        return Listening(self.base_port, bind, self.api_bind or (LOOPBACK if plain and not is_loopback(bind) else bind))


def next_base_port(directory: DirectoryContent, configs: Iterable[NodeConfig]) -> int:
    used = [node.p2p_port for node in directory.nodes.values()] + [config.p2p_port for config in configs]
    return max(used, default=7_262) + PORTS_PER_NODE


def check_joining_node(newcomer: JoiningNode, directory: DirectoryContent) -> None:
    """Check early as the network would. Raises NODE_EXISTS, NOT_FOUND, CONFIGURATION_INVALID."""
    name = newcomer.name
    check_name(name, "a node")
    if name in directory.nodes:
        raise BlockRobotError("NODE_EXISTS", f"There is, or was, a node {name!r} in this network.")
    organisation = directory.organisations.get(newcomer.organisation)
    if organisation is None or not organisation.is_active:
        known = ", ".join(item.name for item in directory.organisations.values() if item.is_active)
        raise BlockRobotError("NOT_FOUND", f"There is no organisation {newcomer.organisation!r}; there are {known}.")
    if not 0 < newcomer.base_port <= _PORT_MAX - 2:
        raise BlockRobotError("CONFIGURATION_INVALID", f"{newcomer.base_port} leaves no room for three ports.")
    if newcomer.host in _EVERYWHERE:
        detail = f"Nobody reaches a node at {newcomer.host}: name the address that others know with --advertise."
        raise BlockRobotError("CONFIGURATION_INVALID", detail)
    check_api_url(name, newcomer.reached_at[2])


def parse_place(text: str) -> tuple[str, int]:
    """Read HOST or HOST:PORT, an IPv6 address with a port in brackets; port 0: none is named.

    Raises CONFIGURATION_INVALID.
    """
    try:
        address = ipaddress.ip_address(text)
    except ValueError:
        pass
    else:
        return str(address), 0
    try:
        parts = urlsplit(f"//{text}")
        host, port = parts.hostname or "", parts.port or 0
    except ValueError:
        host, port = "", 0
    if not _HOST.fullmatch(host) or parts.netloc != text or "@" in text or not 0 <= port <= _PORT_MAX - 1:
        raise BlockRobotError("CONFIGURATION_INVALID", f"{text!r} is no HOST or HOST:PORT.")
    return host, port


def check_api_url(name: str, url: str) -> None:
    """Reject an address that no client would use. Raises CONFIGURATION_INVALID."""
    try:
        check_address(NodeAddress(name, url))
    except BlockRobotError:
        detail = (
            f"No client would talk to {name} at {url}: beyond this machine clients take https:// only, with a "
            "certificate of the organisation's authority. Name such an address with --api-url, or leave it to the node."
        )
        raise BlockRobotError("CONFIGURATION_INVALID", detail) from None


def init_node(
    folder: Path, newcomer: JoiningNode, genesis: Genesis, authority: Authority, directory: DirectoryContent
) -> NodeEntry:
    """Return its entry for approval. Raises NODE_EXISTS."""
    check_joining_node(newcomer, directory)
    if folder.exists():
        raise BlockRobotError("NODE_EXISTS", f"There is something in {folder} already.")
    keys = NodeKeys(new_key(), new_key() if newcomer.is_custodian else None)
    host, p2p_port, api_url = newcomer.reached_at
    entry = NodeEntry(
        name=newcomer.name,
        organisation=newcomer.organisation,
        host=host,
        p2p_port=p2p_port,
        api_url=api_url,
        producer_key=keys.producer.public_key,
        producer_possession=prove_possession(keys.producer, newcomer.name),
        custodian_key=b"" if keys.custodian is None else keys.custodian.public_key,
    )
    folder.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.parent) as own:
        making = Path(own, folder.name)
        create_node(
            making,
            entry,
            keys,
            authority,
            genesis_to_json(genesis),
            store_uri_of(newcomer.store, genesis.network, newcomer.name),
            faults=newcomer.faults,
            organisation=newcomer.organisation,
            listening=newcomer.listening,
        )
        if directory.height > 0:
            write_secret(making / DIRECTORY_FILE, encode_directory(genesis.chain_id, directory))
        (making / ENTRY_FILE).write_text(entry_to_json(entry), encoding="utf-8")
        making.rename(folder)
    return entry


def entry_to_json(entry: NodeEntry) -> str:
    """For `org propose add-node`: named fields, bytes in hex."""
    fields = {name: getattr(entry, name) for name in NodeEntry.__struct_fields__}
    shown = {name: value.hex() if isinstance(value, bytes) else value for name, value in fields.items()}
    return json.dumps(shown, indent=2) + "\n"

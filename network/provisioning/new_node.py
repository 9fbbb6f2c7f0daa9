"""Makes a node's data directory: keys, certificate, empty journal, settings, and the entry by which others know it.

Private keys are raw 32 bytes (TLS: PEM), readable by the owner only.
"""

from __future__ import annotations

import secrets
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import urlsplit

from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import ec

from clients.sdk.new_files import replace_file
from clients.sdk.node_places import PORT_MAX, canonical_url, check_listening, check_place, url_of
from consensus.chain.genesis import NodeEntry, prove_possession
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PRIVATE_KEY_SIZE_BYTES, PrivateKey
from network.provisioning.certificate_authority import (
    Authority,
    encode_private_key,
    issue_node_certificate,
    write_secret,
)
from network.provisioning.certificate_requests import check_certificate, check_fit, make_request
from network.provisioning.exchange_files import read_node_entry
from network.provisioning.founding_entries import node_entry_to_json
from network.provisioning.node_certificates import install
from node.config import CONFIG_FILE, LOOPBACK, OPERATOR_HOST, NodeConfig, config_to_toml, load_config, load_key
from node.consensus.journal import Journal
from node.directory.node_directory import DirectoryContent, DirectoryNode, DirectoryOrganisation
from node.p2p.connection_acceptor import bind_listener
from pages.listening import is_loopback

NODE_ENTRY_FILE = "node-entry.json"
DRAFT_FILE = "node-entry.draft.json"
"""The entry of a founding node that has no certificate yet: nobody has signed it."""
REQUEST_FILE = "node.csr"
_DIRECTORY_FIELDS = ("name", "organisation", "host", "p2p_port", "api_url", "producer_key", "custodian_key")
NAME_MAX_CHARS = 40
_NAME_CHARS = frozenset("abcdefghijklmnopqrstuvwxyz0123456789-")
EVERYWHERE = frozenset({"0.0.0.0", "::"})  # noqa: S104 - refused
Place = tuple[str, int]
"""An address to listen at, and a port."""


@dataclass(frozen=True, slots=True)
class NewNode:
    """A new node's parameters. It listens at `bind` (else `host`), on ports `base_port` to `base_port` + 2.

    Others reach it at `host` and `p2p_port` (else `base_port`), its clients at `api_url` (else `host`, the port after it).
    """

    name: str
    organisation: str
    host: str
    base_port: int
    store: str = "sqlite"
    is_custodian: bool = False
    is_producer: bool = True
    faults: bool = False
    archive: bool = False
    api_url: str = ""
    bind: str = ""
    api_bind: str = ""
    p2p_port: int = 0

    @property
    def reached_at(self) -> tuple[str, int, str]:
        """Host and port for peers, address for clients."""
        port = self.p2p_port or self.base_port
        scheme = "http" if is_loopback(self.host) and is_loopback(self.bind or self.host) else "https"
        return self.host, port, canonical_url(self.api_url) if self.api_url else url_of(scheme, self.host, port + 1)

    @property
    def listens_at(self) -> tuple[str, str]:
        """Addresses for peers and for clients: the same, or loopback for clients if a proxy has to stand before it."""
        bind = self.bind or self.host
        is_plain = self.reached_at[2].startswith("http:")
        return bind, self.api_bind or (LOOPBACK if is_plain and not is_loopback(bind) else bind)

    @property
    def listening_places(self) -> list[Place]:
        bind, api_bind = self.listens_at
        return [(bind, self.base_port), (api_bind, self.base_port + 1), (OPERATOR_HOST, self.base_port + 2)]

    def check(self) -> None:
        """Raises CONFIGURATION_INVALID, NODE_ADDRESS_UNUSABLE."""
        check_name(self.name, "a node")
        if not 0 < self.base_port <= PORT_MAX - 2:
            raise BlockRobotError("CONFIGURATION_INVALID", f"{self.base_port} leaves no room for three ports.")
        if self.host in EVERYWHERE:
            detail = f"Nobody reaches a node at {self.host}: name the address that others know with --advertise."
            raise BlockRobotError("CONFIGURATION_INVALID", detail)
        check_place(self.name, *self.reached_at)
        for option, address in zip(("--bind", "--api-bind"), (self.bind, self.api_bind), strict=True):
            if address:
                check_listening(option, address)


def new_key() -> PrivateKey:
    return PrivateKey(secrets.token_bytes(PRIVATE_KEY_SIZE_BYTES))


def is_name(name: str) -> bool:
    return 0 < len(name) <= NAME_MAX_CHARS and set(name) <= _NAME_CHARS


def check_name(name: str, what: str) -> None:
    """Reject an invalid node or organisation name (also a folder name). Raises CONFIGURATION_INVALID."""
    if not is_name(name):
        text = f"The name of {what} has 1 to {NAME_MAX_CHARS} small letters, digits and hyphens."
        raise BlockRobotError("CONFIGURATION_INVALID", text)


def require_own_ports(new: NewNode, folder: Path) -> None:
    """Raises PORT_IN_USE for those of a node that lies beside it."""
    for path in folder.parent.glob(f"*/{CONFIG_FILE}"):
        try:
            other = load_config(path.parent)
        except BlockRobotError:
            continue
        theirs = [
            (other.host, other.p2p_port),
            (other.api_host, other.api_port),
            (OPERATOR_HOST, other.operator_port),
            *([(other.metrics_host, other.metrics_port)] if other.metrics_host else []),
        ]
        for (host, port), (their_host, their_port) in product(new.listening_places, theirs):
            if port == their_port and (host == their_host or EVERYWHERE & {host, their_host}):
                raise BlockRobotError("PORT_IN_USE", f"{host}:{port} is for {other.name} in {path.parent}.")


def find_listening_troubles(new: NewNode) -> list[BlockRobotError]:
    """Why it could not listen now: ADDRESS_NOT_HERE, PORT_IN_USE, PORT_NOT_PERMITTED."""
    found: dict[str, BlockRobotError] = {}
    for place in new.listening_places:
        try:
            bind_listener(*place).close()
        except BlockRobotError as error:
            found.setdefault(error.detail, error)
    return list(found.values())


def store_uri_of(store: str, network: str, node: str) -> str:
    """A node's own database on a MongoDB server. Raises CONFIGURATION_INVALID."""
    if store == "sqlite":
        return store
    if not store.startswith(("mongodb://", "mongodb+srv://")):
        raise BlockRobotError("CONFIGURATION_INVALID", "The store is sqlite or the URI of a MongoDB server.")
    server, _, options = store.partition("?")
    scheme, _, rest = server.partition("://")
    host = rest.split("/", 1)[0]
    database = f"{network}-{node}".replace(".", "-").replace(" ", "-")
    return f"{scheme}://{host}/{database}" + (f"?{options}" if options else "")


@dataclass(frozen=True, slots=True)
class Founder:
    """The admin who signs the entry of a node that founds a network, and when (ms)."""

    admin: PrivateKey
    made_at_ms: int


def create_node(
    folder: Path,
    new: NewNode,
    authority: Authority | None,
    network: str = "",
    *,
    files: dict[str, bytes] | None = None,
    organisation: str = "",
    founder: Founder | None = None,
) -> NodeEntry:
    """Make the data directory in one step; return the node's entry.

    `network`: what its database on a MongoDB server is named after, else a draw, which keeps two networks apart;
    `files`: what lies in it besides, by name; `organisation`: of a node that the genesis file does not name. Without an
    authority it gets a request for a certificate, and a draft of its entry (`certify_founder`).
    Raises NODE_EXISTS, PORT_IN_USE, CONFIGURATION_INVALID.
    """
    new.check()
    if folder.exists():
        raise BlockRobotError("NODE_EXISTS", f"There is something in {folder} already.")
    require_own_ports(new, folder)
    producer, custodian = new_key(), new_key() if new.is_custodian else None
    host, p2p_port, api_url = new.reached_at
    entry = NodeEntry(
        name=new.name,
        organisation=new.organisation,
        host=host,
        p2p_port=p2p_port,
        api_url=api_url,
        producer_key=producer.public_key if new.is_producer else b"",
        producer_possession=prove_possession(producer, new.name) if new.is_producer else b"",
        custodian_key=b"" if custodian is None else custodian.public_key,
    )
    if founder is None or authority is None:
        written = node_entry_to_json(entry)
    else:
        written = node_entry_to_json(entry, founder.made_at_ms, founder.admin, custodian)
    folder.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=f".{folder.name}.", dir=folder.parent) as own:
        making = Path(own, folder.name)
        making.mkdir(mode=0o700)  # ledger and custody tell who was where when
        config = _config_of(
            making,
            new,
            store_uri_of(new.store, network or f"blockrobot-{secrets.token_hex(4)}", new.name),
            organisation,
        )
        if authority is None:
            write_secret(config.tls_key_path, encode_private_key(ec.generate_private_key(ec.SECP256R1())))
            (making / REQUEST_FILE).write_bytes(make_request(config, new.organisation, hosts_of(entry)))
        else:
            certificate = issue_node_certificate(authority, new.name, *hosts_of(entry))
            write_secret(config.tls_key_path, certificate.key_pem)
            write_secret(config.tls_certificate_path, certificate.certificate_pem)
        write_secret(making / "keys" / "producer.key", producer.secret)
        if custodian is not None:
            write_secret(making / "keys" / "custodian.key", custodian.secret)
        config.journal_dir.mkdir(parents=True, exist_ok=True)
        Journal.create(config.journal_path).close()
        write_secret(making / CONFIG_FILE, config_to_toml(config).encode())
        (making / (DRAFT_FILE if authority is None else NODE_ENTRY_FILE)).write_text(written, encoding="utf-8")
        for name, content in (files or {}).items():
            write_secret(making / name, content)
        making.rename(folder)
    return entry


def hosts_of(entry: NodeEntry | DirectoryNode) -> tuple[str, str]:
    """Where peers and clients reach it, as its certificate has to say."""
    return entry.host, urlsplit(entry.api_url).hostname or entry.host


def read_founding_entry(data_dir: Path) -> NodeEntry | None:
    """Of a node whose network is not founded yet, signed or not. Raises FILE_UNUSABLE."""
    for path in (data_dir / DRAFT_FILE, data_dir / NODE_ENTRY_FILE):
        if path.is_file() and not (data_dir / "genesis.json").is_file():
            return NodeEntry(**read_node_entry(path))
    return None


def require_certified(data_dir: Path) -> None:
    """Raises NODE_NOT_CERTIFIED."""
    if (data_dir / DRAFT_FILE).is_file():
        raise BlockRobotError("NODE_NOT_CERTIFIED", f"The node in {data_dir} has no certificate yet.")


def certify_founder(
    config: NodeConfig, entry: NodeEntry, pem: bytes, ca_certificate: str, founder: Founder
) -> x509.Certificate:
    """Install the certificate that was issued for a founding node's request, and sign its entry if that is a draft.

    Raises as `check_certificate`, and CERTIFICATE_UNFIT.
    """
    directory = DirectoryContent(
        height=0,
        nodes={entry.name: DirectoryNode(**{name: getattr(entry, name) for name in _DIRECTORY_FIELDS})},
        organisations={entry.organisation: DirectoryOrganisation(entry.organisation, ca_certificate)},
    )
    made = check_certificate(config, pem, directory, founder.made_at_ms)
    check_fit(made, (entry.name, *hosts_of(entry)))
    install(config, made)
    if (config.data_dir / DRAFT_FILE).is_file():
        path = config.custodian_key_path
        custodian = None if path is None else load_key(path, entry.custodian_key, "custodian")
        text = node_entry_to_json(entry, founder.made_at_ms, founder.admin, custodian)
        replace_file(config.data_dir / NODE_ENTRY_FILE, text.encode(), mode=0o644)
        (config.data_dir / DRAFT_FILE).unlink()
        (config.data_dir / REQUEST_FILE).unlink(missing_ok=True)
    return made


def _config_of(folder: Path, new: NewNode, store_uri: str, organisation: str) -> NodeConfig:
    bind, api_bind = new.listens_at
    return NodeConfig(
        data_dir=folder,
        name=new.name,
        genesis_path=folder / "genesis.json",
        host=bind,
        p2p_port=new.base_port,
        api_host=api_bind,
        api_tls=not is_loopback(api_bind),
        api_port=new.base_port + 1,
        operator_port=new.base_port + 2,
        tls_certificate_path=folder / "keys" / "tls.crt.pem",
        tls_key_path=folder / "keys" / "tls.key.pem",
        producer_key_path=folder / "keys" / "producer.key",
        custodian_key_path=folder / "keys" / "custodian.key" if new.is_custodian else None,
        custody_store=store_uri,
        log_level="info",
        faults_enabled=new.faults,
        archive=new.archive,
        organisation=organisation,
    )

"""Creates a network on disk: keys, certificates, genesis, data directories.

    DIRECTORY/genesis.json
    DIRECTORY/organisations/<name>/   ca.crt.pem, ca.key.pem, admin.key, registrar.key, organisation-entry.json
    DIRECTORY/nodes/<name>/           node.toml, genesis.json, keys/, journal/

Private keys are raw 32 bytes (TLS and CA: PEM), readable by the owner only.
"""

from __future__ import annotations

import secrets
import shutil
import tempfile
import time
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from consensus.chain.genesis import (
    GENESIS_VERSION,
    ChainSettings,
    Genesis,
    NodeEntry,
    Organisation,
    genesis_to_json,
    prove_possession,
)
from consensus.errors import BlockRobotError
from consensus.limits import PRODUCERS_MAX_COUNT
from consensus.primitives.keys import PRIVATE_KEY_SIZE_BYTES, PrivateKey
from consensus.rights.purposes import PURPOSES
from contracts.execution.genesis import complete_genesis
from contracts.lifecycle.registry import contract_entries
from contracts.vm import LANGUAGE_VERSION
from network.provisioning.certificate_authority import (
    Authority,
    create_authority,
    encode_private_key,
    issue_node_certificate,
    write_secret,
)
from network.provisioning.exchange_files import ORGANISATION_ENTRY_FILE, organisation_entry_to_json
from network.provisioning.network_removal import MAKING_MARK, marked_as_making, remove_abandoned
from node.config import CONFIG_FILE, LOOPBACK, NodeConfig, config_to_toml
from node.consensus.journal import Journal
from pages.listening import is_loopback

PORTS_PER_NODE = 10
NAME_MAX_CHARS = 40
_NAME_CHARS = frozenset("abcdefghijklmnopqrstuvwxyz0123456789-")
NETWORK_FOLDER_MODE = 0o755
_ORGANISATION_NAMES = ("hospital", "university")


@dataclass(frozen=True, slots=True)
class Listening:
    """Where a node listens: for peers at `host` and `base_port`, for clients at `api_host` and the port after it."""

    base_port: int
    host: str = LOOPBACK
    api_host: str = LOOPBACK


@dataclass(frozen=True, slots=True)
class NodeKeys:
    """A node's two signing keys; only custodians have the second."""

    producer: PrivateKey
    custodian: PrivateKey | None


def new_key() -> PrivateKey:
    return PrivateKey(secrets.token_bytes(PRIVATE_KEY_SIZE_BYTES))


def organisation_name(number: int) -> str:
    return _ORGANISATION_NAMES[number] if number < len(_ORGANISATION_NAMES) else f"organisation-{number + 1}"


def store_uri_of(store: str, network: str, node: str) -> str:
    if store == "sqlite":
        return store
    if not store.startswith(("mongodb://", "mongodb+srv://")):
        raise BlockRobotError("CONFIGURATION_INVALID", "The store is sqlite or the URI of a MongoDB server.")
    server, _, options = store.partition("?")
    scheme, _, rest = server.partition("://")
    host = rest.split("/", 1)[0]
    database = f"{network}-{node}".replace(".", "-").replace(" ", "-")
    return f"{scheme}://{host}/{database}" + (f"?{options}" if options else "")


def create_network(
    directory: Path,
    *,
    nodes: int = 4,
    organisations: int = 2,
    base_port: int,
    store: str = "sqlite",
    network: str = "blockrobot",
    settings: ChainSettings | None = None,
    faults: bool = False,
    followers: int = 0,
    archives: Collection[str] = (),
) -> Genesis:
    """Create a network atomically; return its genesis. `faults`: permit fault injection.

    The last `followers` are no producers; `archives` keep every block. Node i (from 0) listens on base_port + 10*i
    (peers), +1 (clients), +2 (operator); each organisation's first node is a custodian. `store`: `sqlite` or a MongoDB
    URI. Raises CONFIGURATION_INVALID, DATA_DIRECTORY_INVALID if a network exists, FOLDER_NOT_EMPTY.
    """
    if not 1 <= nodes <= PRODUCERS_MAX_COUNT or not 1 <= organisations <= nodes:
        raise BlockRobotError(
            "CONFIGURATION_INVALID", f"A network has 1 to {PRODUCERS_MAX_COUNT} nodes, and no more organisations."
        )
    if not 0 < base_port <= 65_535 - PORTS_PER_NODE * nodes:
        raise BlockRobotError("CONFIGURATION_INVALID", "The base port leaves no room for the nodes' ports.")
    unknown = sorted({*archives} - {f"node-{number + 1}" for number in range(nodes)})
    if unknown:
        raise BlockRobotError("CONFIGURATION_INVALID", f"The network has no node {unknown[0]!r} to be an archive.")
    if (directory / "genesis.json").exists():
        raise BlockRobotError("DATA_DIRECTORY_INVALID", f"There is a network in {directory} already.")
    if directory.exists() and any(directory.iterdir()):
        raise BlockRobotError("FOLDER_NOT_EMPTY", f"{directory} is not empty, and what is in it is no network.")
    directory.parent.mkdir(parents=True, exist_ok=True)
    remove_abandoned(directory)
    making = Path(tempfile.mkdtemp(prefix=f".{directory.name}.", dir=directory.parent))
    try:
        making.chmod(NETWORK_FOLDER_MODE)
        with marked_as_making(making):
            genesis = _write_network(
                making,
                nodes,
                organisations,
                base_port,
                store,
                network,
                settings,
                faults=faults,
                followers=followers,
                archives=archives,
            )
            _put_in_place(making, directory)
        (directory / MAKING_MARK).unlink(missing_ok=True)
    except BaseException:
        shutil.rmtree(making, ignore_errors=True)
        raise
    return genesis


def _put_in_place(making: Path, directory: Path) -> None:
    try:
        making.rename(directory)
    except OSError as error:
        text = f"Something came into {directory} while the network was made: perhaps another command makes one there."
        raise BlockRobotError("FOLDER_NOT_EMPTY", text) from error


def check_name(name: str, what: str) -> None:
    """Reject an invalid node or organisation name (also a folder name). Raises CONFIGURATION_INVALID."""
    if not 0 < len(name) <= NAME_MAX_CHARS or not set(name) <= _NAME_CHARS:
        text = f"The name of {what} has 1 to {NAME_MAX_CHARS} small letters, digits and hyphens."
        raise BlockRobotError("CONFIGURATION_INVALID", text)


def _write_network(
    directory: Path,
    nodes: int,
    organisations: int,
    base_port: int,
    store: str,
    network: str,
    settings: ChainSettings | None,
    *,
    faults: bool,
    followers: int,
    archives: Collection[str],
) -> Genesis:
    names = [f"node-{number + 1}" for number in range(nodes)]
    keys = [NodeKeys(new_key(), new_key() if number < organisations else None) for number in range(nodes)]
    authorities = [create_organisation(directory, organisation_name(number)) for number in range(organisations)]
    genesis = complete_genesis(
        Genesis(
            version=GENESIS_VERSION,
            network=network,
            created_at_ms=time.time_ns() // 1_000_000,
            settings=settings or ChainSettings(),
            organisations=tuple(entry for _, entry in authorities),
            nodes=tuple(
                _node_entry(
                    name,
                    organisation_name(number % organisations),
                    base_port + PORTS_PER_NODE * number,
                    keys[number],
                    produces=number < nodes - followers,
                )
                for number, name in enumerate(names)
            ),
            contracts=contract_entries(),
            purposes=tuple(PURPOSES),
            state_root=b"",
            contract_language=LANGUAGE_VERSION,
        )
    )
    text = genesis_to_json(genesis)
    for number, entry in enumerate(genesis.nodes):
        authority = authorities[number % organisations][0]
        create_node(
            directory / "nodes" / entry.name,
            entry,
            keys[number],
            authority,
            text,
            store_uri_of(store, network, entry.name),
            faults=faults,
            archive=entry.name in archives,
        )
    (directory / "genesis.json").write_text(text, encoding="utf-8")
    return genesis


def create_organisation(directory: Path, name: str) -> tuple[Authority, Organisation]:
    """Create an organisation's folder: CA, admin and registrar keys, public entry.

    Raises ORGANISATION_EXISTS, CONFIGURATION_INVALID for an invalid name.
    """
    check_name(name, "an organisation")
    folder = directory / "organisations" / name
    if folder.exists():
        raise BlockRobotError("ORGANISATION_EXISTS", f"There is an organisation in {folder} already.")
    authority = create_authority(name)
    admin, registrar = new_key(), new_key()
    write_secret(folder / "ca.key.pem", encode_private_key(authority.key))
    (folder / "ca.crt.pem").write_text(authority.certificate_pem, encoding="utf-8")
    write_secret(folder / "admin.key", admin.secret)
    write_secret(folder / "registrar.key", registrar.secret)
    entry = Organisation(
        name=name,
        ca_certificate=authority.certificate_pem,
        admins=(admin.public_key,),
        registrars=(registrar.public_key,),
    )
    (folder / ORGANISATION_ENTRY_FILE).write_text(organisation_entry_to_json(entry), encoding="utf-8")
    return authority, entry


def _node_entry(name: str, organisation: str, port: int, keys: NodeKeys, *, produces: bool = True) -> NodeEntry:
    return NodeEntry(
        name=name,
        organisation=organisation,
        host=LOOPBACK,
        p2p_port=port,
        api_url=f"http://{LOOPBACK}:{port + 1}",
        producer_key=keys.producer.public_key if produces else b"",
        producer_possession=prove_possession(keys.producer, name) if produces else b"",
        custodian_key=b"" if keys.custodian is None else keys.custodian.public_key,
    )


def create_node(
    folder: Path,
    entry: NodeEntry,
    keys: NodeKeys,
    authority: Authority,
    genesis_text: str,
    store_uri: str,
    *,
    faults: bool,
    organisation: str = "",
    archive: bool = False,
    listening: Listening | None = None,
) -> None:
    """Create a node's data directory; `organisation` if genesis does not name the node.

    `listening`: else on loopback, at the ports of its entry.

    Raises FileExistsError.
    """
    listening = listening or Listening(entry.p2p_port)
    folder.mkdir(parents=True, mode=0o700)  # ledger and custody tell who was where when
    config = NodeConfig(
        data_dir=folder,
        name=entry.name,
        genesis_path=folder / "genesis.json",
        host=listening.host,
        p2p_port=listening.base_port,
        api_host=listening.api_host,
        api_tls=not is_loopback(listening.api_host),
        api_port=listening.base_port + 1,
        operator_port=listening.base_port + 2,
        tls_certificate_path=folder / "keys" / "tls.crt.pem",
        tls_key_path=folder / "keys" / "tls.key.pem",
        producer_key_path=folder / "keys" / "producer.key",
        custodian_key_path=None if keys.custodian is None else folder / "keys" / "custodian.key",
        custody_store=store_uri,
        log_level="info",
        faults_enabled=faults,
        archive=archive,
        organisation=organisation,
    )
    hosts = entry.host, urlsplit(entry.api_url).hostname or entry.host
    certificate = issue_node_certificate(authority, entry.name, *hosts)
    write_secret(config.tls_key_path, certificate.key_pem)
    write_secret(config.tls_certificate_path, certificate.certificate_pem)
    write_secret(folder / "keys" / "producer.key", keys.producer.secret)
    if keys.custodian is not None:
        write_secret(folder / "keys" / "custodian.key", keys.custodian.secret)
    config.journal_dir.mkdir(parents=True, exist_ok=True)
    Journal.create(config.journal_path).close()
    config.genesis_path.write_text(genesis_text, encoding="utf-8")
    write_secret(folder / CONFIG_FILE, config_to_toml(config).encode())

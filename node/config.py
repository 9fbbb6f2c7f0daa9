"""A node's configuration: `node.toml` in its data directory, with relative paths."""

from __future__ import annotations

import json
from dataclasses import dataclass
from ipaddress import ip_network
from pathlib import Path
from typing import Any

from consensus.bounded_text import TextInvalidError, read_toml_text
from consensus.chain.genesis import Genesis, genesis_from_json, require_possession
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from consensus.state.identity import ROOM_MAX_GIB
from node.clips_place import REGION_DEFAULT, ClipsPlace, read_place
from node.limits.disk_reserve import RESERVE_DEFAULT_MIB
from pages.listening import is_loopback

CONFIG_FILE = "node.toml"
CUSTODY_NAME = "custody"
KEEP_BLOCKS_MIN_COUNT = 256
"""A node serves at least so many blocks to peers that missed a few."""
KEEP_BLOCKS_COUNT = 10_000
SNAPSHOT_LAG_BLOCKS = 100_000
SNAPSHOT_LAG_MIN_BLOCKS = 100
LOOPBACK = "127.0.0.1"
OPERATOR_HOST = LOOPBACK
"""Where the operator's listener is, wherever the node listens for peers and clients."""
READING_TOKEN_FILE_NAME = "operator-read.token"  # noqa: S105 - a file's name
_PORT_MAX = 65_535
CONTRACT_MEMORY_MIB = 1024
"""The modelled memory of a call is 8 MiB, and its real peak at most four times that. The rest is for what a worker keeps:
the results of up to 384 blocks above the ledger, a MiB each if they are full, and the compiled forms of 64 sources."""
CONTRACT_MEMORY_MIN_MIB = 4
_SANDBOX_MODES = ("on", "require", "off")
_LOG_PLACES = ("file", "stdout", "both")
_LOG_LEVELS = ("debug", "info", "warning", "error")
SECTIONS: dict[str, frozenset[str]] = {
    "node": frozenset({"name", "genesis", "organisation"}),
    "listen": frozenset({"host", "api_host", "api_tls", "trusted_proxies", "p2p_port", "api_port", "operator_port"}),
    "keys": frozenset({"tls_certificate", "tls_key", "producer", "custodian"}),
    "metrics": frozenset({"host", "port"}),
    "custody": frozenset(
        {"store", "reserve_mib", "room_gib", "clips", "clips_endpoint", "clips_region", "clips_ca", "clips_credentials"}
    ),
    "log": frozenset({"level", "to"}),
    "faults": frozenset({"enabled"}),
    "storage": frozenset({"archive", "keep_blocks", "snapshot_lag_blocks"}),
    "contracts": frozenset({"sandbox", "memory_mib"}),
    "explorer": frozenset({"public"}),
}
"""The tables of the file and their fields."""


@dataclass(frozen=True, slots=True)
class NodeConfig:
    """A node's start-up settings; ports are TCP, paths absolute.

    `host` is where it listens for peers, `api_host` for clients; where others reach it, its entry in the network says.
    """

    data_dir: Path
    name: str
    genesis_path: Path
    host: str
    p2p_port: int
    api_port: int
    operator_port: int
    tls_certificate_path: Path
    tls_key_path: Path
    producer_key_path: Path | None
    custodian_key_path: Path | None
    custody_store: str
    log_level: str
    api_host: str = "127.0.0.1"
    api_tls: bool = False
    """Whether clients are served over TLS, by the node's own certificate. Off only on loopback, where a proxy may be."""
    trusted_proxies: tuple[str, ...] = ()
    """Addresses or networks of proxies whose X-Forwarded-For is believed."""
    metrics_host: str = ""
    """Where other machines may ask for liveness, readiness and metrics; empty: nowhere."""
    metrics_port: int = 0
    log_to: str = "file"
    """Where the log goes: "file", in the data directory, "stdout", or "both"."""
    custody_reserve_mib: int = RESERVE_DEFAULT_MIB
    """Free space below which the node takes no uploads; 0: none."""
    custody_room_gib: int = 0
    """The room that the custodian declares on the chain; 0: none."""
    clips: ClipsPlace | None = None
    """Where the custodian's ciphertexts lie; None: in its store."""
    faults_enabled: bool = False
    archive: bool = False
    """Whether the node keeps the bodies of all blocks for ever."""
    keep_blocks: int = KEEP_BLOCKS_COUNT
    """How many of the newest blocks keep their bodies, however old they are."""
    snapshot_lag_blocks: int = SNAPSHOT_LAG_BLOCKS
    """From how many blocks behind on a snapshot is preferred to blocks; 0: only where there is no other way."""
    contract_sandbox: str = "on"
    """Whether contracts run in worker processes in a sandbox: "on", "require" (all of it, or no start), "off"."""
    contract_memory_mib: int = CONTRACT_MEMORY_MIB
    """How many MiB a contract worker may take beyond what it has at its start; twice as many after each failure on a block
    that others executed."""
    public_explorer: bool = False
    """Whether the explorer shows headers, producers and counts to anybody, without a session."""
    organisation: str = ""
    """Only for a node that joined later: whose it is. The genesis file says so of the first ones."""

    @property
    def ledger_dir(self) -> Path:
        return self.data_dir / "ledger"

    @property
    def snapshots_dir(self) -> Path:
        return self.data_dir / "snapshots"

    @property
    def fetched_dir(self) -> Path:
        return self.data_dir / "snapshots.fetched"

    @property
    def journal_dir(self) -> Path:
        return self.data_dir / "journal"

    @property
    def journal_path(self) -> Path:
        return self.journal_dir / "votes.journal"

    @property
    def custody_dir(self) -> Path:
        return self.data_dir / CUSTODY_NAME

    @property
    def erase_keys_dir(self) -> Path:
        """Outside the database and its backups."""
        return self.data_dir / "erase-keys"

    @property
    def clips_dir(self) -> Path | None:
        """Where the custodian's ciphertexts are files, maybe of a disk of its own."""
        return None if self.clips is None else self.clips.folder

    @property
    def log_path(self) -> Path:
        return self.data_dir / "node.log"

    def name_of(self, path: Path) -> str:
        """From the data directory on, if it lies there."""
        return str(path.relative_to(self.data_dir) if path.is_relative_to(self.data_dir) else path)


def _invalid(detail: str) -> BlockRobotError:
    return BlockRobotError("CONFIGURATION_INVALID", f"{CONFIG_FILE}: {detail}")


class _Section:
    def __init__(self, document: dict[str, Any], name: str) -> None:
        table = document.get(name, {})
        if not isinstance(table, dict):
            raise _invalid(f"[{name}] is not a table.")
        unknown = sorted(set(table) - SECTIONS[name])
        if unknown:
            raise _invalid(f"[{name}] has an unknown field {unknown[0]!r}.")
        self._name, self._table = name, table

    def text(self, field: str, default: str | None = None) -> str:
        value = self._table.get(field, default)
        if not isinstance(value, str) or not value or "\0" in value:
            raise _invalid(f"[{self._name}] needs the text {field!r}.")
        return value

    def optional_text(self, field: str) -> str | None:
        return self.text(field) if field in self._table else None

    def port(self, field: str) -> int:
        value = self._table.get(field)
        if not isinstance(value, int) or isinstance(value, bool) or not 0 < value <= _PORT_MAX:
            raise _invalid(f"[{self._name}] needs a port number {field!r}.")
        return value

    def count(self, field: str, least: int, default: int, most: int = 1 << 62) -> int:
        value = self._table.get(field, default)
        if not isinstance(value, int) or isinstance(value, bool) or not (value == 0 or least <= value <= most):
            text = f"0, or {least} to {most}," if most < 1 << 62 else f"0, or a number of at least {least},"
            raise _invalid(f"[{self._name}] needs {text} for {field!r}.")
        return value

    def size(self, field: str, least: int, default: int) -> int:
        value = self._table.get(field, default)
        if not isinstance(value, int) or isinstance(value, bool) or value < least:
            raise _invalid(f"[{self._name}] needs a number of at least {least} for {field!r}.")
        return value

    def networks(self, field: str) -> tuple[str, ...]:
        value = self._table.get(field, [])
        try:
            if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
                raise ValueError
            return tuple(str(ip_network(item)) for item in value)
        except ValueError:
            raise _invalid(f"[{self._name}] {field} is a list of addresses, or of networks as 10.0.0.0/24.") from None

    def flag(self, field: str, default: bool = False) -> bool:
        value = self._table.get(field, default)
        if not isinstance(value, bool):
            raise _invalid(f"[{self._name}] needs true or false for {field!r}.")
        return value


def load_config(data_dir: Path, file_name: str = CONFIG_FILE) -> NodeConfig:
    """Raises DATA_DIRECTORY_INVALID if it is missing, CONFIGURATION_INVALID."""
    path = data_dir / file_name
    try:
        document = read_toml_text(path.read_bytes())
    except (FileNotFoundError, NotADirectoryError):
        raise BlockRobotError("DATA_DIRECTORY_INVALID", f"There is no {file_name} in {data_dir}.") from None
    except TextInvalidError as error:
        raise _invalid(f"it is not TOML: {error}.") from None
    unknown = sorted(set(document) - set(SECTIONS))
    if unknown:
        raise _invalid(f"there is an unknown table [{unknown[0]}].")
    node, listen, keys, metrics, custody, log, faults, storage, contracts, explorer = (
        _Section(document, name) for name in SECTIONS
    )
    ports = [listen.port("p2p_port"), listen.port("api_port"), listen.port("operator_port")]
    metrics_host = metrics.optional_text("host") or ""
    if metrics_host:
        ports.append(metrics.port("port"))
    if len(set(ports)) != len(ports):
        raise _invalid("[listen] and [metrics] name a port twice.")
    host = listen.text("host", LOOPBACK)
    api_host = listen.text("api_host", host)
    api_tls = listen.flag("api_tls", default=not is_loopback(api_host))
    if not api_tls and not is_loopback(api_host):
        raise _invalid(
            f"clients that reach {api_host} need TLS: leave [listen] api_tls out, or set api_host to 127.0.0.1 for a "
            "proxy on this machine."
        )
    level = log.text("level", "info")
    if level not in _LOG_LEVELS:
        raise _invalid(f"[log] level is one of {', '.join(_LOG_LEVELS)}.")
    log_to = log.text("to", "file")
    if log_to not in _LOG_PLACES:
        raise _invalid(f"[log] to is one of {', '.join(_LOG_PLACES)}.")
    sandbox = contracts.text("sandbox", "on")
    if sandbox not in _SANDBOX_MODES:
        raise _invalid(f"[contracts] sandbox is one of {', '.join(_SANDBOX_MODES)}.")
    producer, custodian = keys.optional_text("producer"), keys.optional_text("custodian")
    return NodeConfig(
        data_dir=data_dir,
        name=node.text("name"),
        genesis_path=data_dir / node.text("genesis", "genesis.json"),
        host=host,
        api_host=api_host,
        api_tls=api_tls,
        trusted_proxies=listen.networks("trusted_proxies"),
        p2p_port=ports[0],
        api_port=ports[1],
        operator_port=ports[2],
        tls_certificate_path=data_dir / keys.text("tls_certificate"),
        tls_key_path=data_dir / keys.text("tls_key"),
        producer_key_path=data_dir / producer if producer else None,
        custodian_key_path=data_dir / custodian if custodian else None,
        custody_store=custody.text("store", "sqlite"),
        log_level=level,
        log_to=log_to,
        metrics_host=metrics_host,
        metrics_port=ports[-1] if metrics_host else 0,
        clips=_read_clips(custody, data_dir),
        custody_reserve_mib=custody.count("reserve_mib", 1, RESERVE_DEFAULT_MIB),
        custody_room_gib=custody.count("room_gib", 1, 0, ROOM_MAX_GIB),
        faults_enabled=faults.flag("enabled"),
        archive=storage.flag("archive"),
        keep_blocks=storage.size("keep_blocks", KEEP_BLOCKS_MIN_COUNT, KEEP_BLOCKS_COUNT),
        snapshot_lag_blocks=storage.count("snapshot_lag_blocks", SNAPSHOT_LAG_MIN_BLOCKS, SNAPSHOT_LAG_BLOCKS),
        contract_sandbox=sandbox,
        contract_memory_mib=contracts.size("memory_mib", CONTRACT_MEMORY_MIN_MIB, CONTRACT_MEMORY_MIB),
        public_explorer=explorer.flag("public"),
        organisation=node.optional_text("organisation") or "",
    )


def config_to_toml(config: NodeConfig) -> str:
    """Paths in its data directory are relative to that."""
    keys = {
        "tls_certificate": config.tls_certificate_path,
        "tls_key": config.tls_key_path,
        "producer": config.producer_key_path,
        "custodian": config.custodian_key_path,
    }
    lines = [
        "[node]",
        f'name = "{config.name}"',
        f"genesis = {_quoted(config.name_of(config.genesis_path))}",
        *([f'organisation = "{config.organisation}"'] if config.organisation else []),
        "",
        "[listen]",
        f'host = "{config.host}"',
        *([f'api_host = "{config.api_host}"'] if config.api_host != config.host else []),
        *([f"api_tls = {str(config.api_tls).lower()}"] if config.api_tls == is_loopback(config.api_host) else []),
        *([f"trusted_proxies = {json.dumps(config.trusted_proxies)}"] if config.trusted_proxies else []),
        f"p2p_port = {config.p2p_port}",
        f"api_port = {config.api_port}",
        f"operator_port = {config.operator_port}",
        "",
        "[keys]",
        *(f"{name} = {_quoted(config.name_of(path))}" for name, path in keys.items() if path),
        *(_metrics_lines(config) if config.metrics_host else []),
        "",
        "[custody]",
        f"store = {_quoted(config.custody_store)}",
        f"reserve_mib = {config.custody_reserve_mib}",
        *([f"room_gib = {config.custody_room_gib}"] if config.custody_room_gib else []),
        *(_clips_lines(config.clips) if config.clips else []),
        "",
        "[log]",
        f'level = "{config.log_level}"',
        *([f'to = "{config.log_to}"'] if config.log_to != "file" else []),
        *(["", "[faults]", "enabled = true"] if config.faults_enabled else []),
        "",
        "[storage]",
        *(["archive = true"] if config.archive else []),
        f"keep_blocks = {config.keep_blocks}",
        f"snapshot_lag_blocks = {config.snapshot_lag_blocks}",
        "",
        "[contracts]",
        f'sandbox = "{config.contract_sandbox}"',
        *([f"memory_mib = {config.contract_memory_mib}"] if config.contract_memory_mib != CONTRACT_MEMORY_MIB else []),
        *(["", "[explorer]", "public = true"] if config.public_explorer else []),
    ]
    return "\n".join(lines) + "\n"


def _read_clips(custody: _Section, data_dir: Path) -> ClipsPlace | None:
    url = custody.optional_text("clips")
    if url is None:
        return None
    ca, credentials = custody.optional_text("clips_ca"), custody.optional_text("clips_credentials")
    return read_place(
        url,
        data_dir,
        endpoint=custody.optional_text("clips_endpoint") or "",
        region=custody.text("clips_region", REGION_DEFAULT),
        ca_path=data_dir / ca if ca else None,
        credentials_path=data_dir / credentials if credentials else None,
    )


def _clips_lines(place: ClipsPlace) -> list[str]:
    fields = {
        "clips": place.url,
        "clips_endpoint": place.endpoint,
        "clips_region": "" if place.region == REGION_DEFAULT else place.region,
        "clips_ca": place.ca_path,
        "clips_credentials": place.credentials_path,
    }
    return [f"{name} = {_quoted(str(value))}" for name, value in fields.items() if value]


def _quoted(text: str) -> str:
    """JSON's escapes are TOML's, but for those of characters beyond 16 bits."""
    return json.dumps(text, ensure_ascii=False)


def _metrics_lines(config: NodeConfig) -> list[str]:
    return ["", "[metrics]", f'host = "{config.metrics_host}"', f"port = {config.metrics_port}"]


def load_genesis(config: NodeConfig) -> Genesis:
    """Read genesis; check this node's entry and all producers' proofs of possession.

    A node that joined later is not in it. Raises GENESIS_INVALID, CONFIGURATION_INVALID.
    """
    try:
        genesis = genesis_from_json(config.genesis_path.read_bytes())
    except FileNotFoundError:
        raise _invalid(f"the genesis file {config.genesis_path.name} is missing.") from None
    if not config.organisation and config.name not in {node.name for node in genesis.nodes}:
        raise _invalid(f"the genesis file names no node {config.name!r}.")
    require_possession(genesis)
    return genesis


def load_key(path: Path, expected: bytes | None, role: str) -> PrivateKey:
    """Read a raw 32-byte key; compare it to the known 33-byte public key.

    Raises CONFIGURATION_INVALID, never containing key bytes.
    """
    try:
        secret = path.read_bytes()
    except FileNotFoundError:
        raise _invalid(f"the {role} key file {path.name} is missing.") from None
    try:
        key = PrivateKey(secret)
    except BlockRobotError:
        raise _invalid(f"the {role} key file {path.name} does not hold a key.") from None
    if expected is not None and key.public_key != expected:
        raise _invalid(f"the {role} key is not the one that the genesis file names for this node.")
    return key


def reading_headers(config: NodeConfig) -> dict[str, str]:
    """Return headers for inspecting a node; empty without access to its data directory."""
    try:
        token = (config.data_dir / READING_TOKEN_FILE_NAME).read_text(encoding="ascii").strip()
    except (OSError, UnicodeDecodeError):
        return {}
    return {"Authorization": f"Bearer {token}"}

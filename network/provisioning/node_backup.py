"""Backs a node up while it runs, and makes it anew from that on a host where nothing of it is left.

A backup has the node's settings, a snapshot of its ledger and its custodian's database, if that is not MongoDB's. It never
has erase keys, which would bring erased pictures back, nor the journal, which must not be older than the node's last run;
keys only if asked for. Whoever can write where it lies can change it, so a restore takes named files of it, and no others.
"""

from __future__ import annotations

import dataclasses
import hashlib
import re
import shutil
import sqlite3
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote_plus

import msgspec

from clients.sdk.new_files import (
    new_file,
    read_given_file,
    read_given_text,
    require_own_folder,
    sync_folder,
    write_new_file,
)
from consensus.bounded_text import JSON_MAX_BYTES, TextInvalidError, read_json_as, read_toml_text
from consensus.chain.genesis import Genesis
from consensus.chain.schedule import Schedule
from consensus.errors import BlockRobotError
from contracts.execution.epochs import read_epoch
from network.provisioning.network_files import HALF_DONE, remove_marked
from network.provisioning.node_certificates import read_report
from network.provisioning.node_joining import newest_directory
from node.clips_place import ClipsPlace
from node.config import CONFIG_FILE, LOOPBACK, NodeConfig, load_config, load_genesis, load_key
from node.custody.blobs.blob_store import OWNER_NAME
from node.custody.blobs.place_file import PLACE_FILE_NAME
from node.custody.erase_keys import ERASE_KEYS_FILE_NAME
from node.custody.stores.open_store import mongo_options
from node.custody.stores.sqlite_schema import distrust
from node.custody.stores.sqlite_store import DATABASE_FILE_NAME
from node.directory.directory_file import DIRECTORY_FILE
from node.faults import STATE_FILE_NAME as FAULTS_FILE_NAME
from node.snapshot.making import make_snapshot_folder
from node.snapshot.restoring import restore_ledger
from node.snapshot.snapshot_format import SnapshotFolder
from node.storage.directory_lock import LOCK_FILE_NAME, DirectoryLock
from node.storage.lmdb_reader import LedgerFile
from node.storage.synced_files import write_synced

MANIFEST_FILE = "backup.json"
VERSION = 1
NODE, LEDGER, KEYS = "node", "ledger", "keys"
CUSTODY_DATABASE, CUSTODY_PLACE = f"custody/{DATABASE_FILE_NAME}", f"custody/{PLACE_FILE_NAME}"
FILES_MAX_COUNT = 100_000
KEEP_MAX_COUNT = 1_000
_OPTIONS = re.compile(
    """appname|authmechanism|authsource|compressors|directconnection|heartbeatfrequencyms|journal|loadbalanced
    |localthresholdms|maxconnecting|(max|min)poolsize|maxidletimems|maxstalenessseconds|readconcernlevel
    |readpreference(tags)?|replicaset|retry(reads|writes)|srvmaxhosts|ssl|(connect|serverselection|socket|waitqueue|w)?timeoutms
    |tls|tls(ca|crl|certificatekey)file|tlsdisableocspendpointcheck|w|zlibcompressionlevel""",
    re.VERBOSE | re.IGNORECASE,
)
_MECHANISMS = frozenset({"DEFAULT", "MONGODB-X509", "SCRAM-SHA-1", "SCRAM-SHA-256"})
"""What of a MongoDB address a backup may hold: no secret, and no login by credentials that a host has for its driver."""
Tell = Callable[[str], None]


class BackupManifest(msgspec.Struct, frozen=True, kw_only=True):
    """What a backup holds; `files`: SHA-256 (hexadecimal) by path."""

    version: int
    node: str
    chain_id: str
    height: int
    made_at_ms: int
    files: dict[str, str]

    def has(self, part: str) -> bool:
        return part in self.files or any(name.startswith(f"{part}/") for name in self.files)


@dataclass(frozen=True, slots=True)
class Restored:
    """A node made anew: of which network, up to which block, and with what."""

    config: NodeConfig
    genesis: Genesis
    height: int
    has_custody: bool
    warning: str


def back_up(config: NodeConfig, out: Path, *, with_keys: bool, tell: Tell = lambda _step: None) -> BackupManifest:
    """Make the folder `out`, whole or not at all, of a node that runs or not; it is on the disk once this returns.

    The password of a MongoDB server is left out. Raises FILE_EXISTS, DATA_DIRECTORY_*, CONFIGURATION_INVALID, STORAGE_*,
    FILE_UNUSABLE.
    """
    if out.exists():
        raise BlockRobotError("FILE_EXISTS", f"There is something in {out} already.")
    genesis = load_genesis(config)
    if with_keys:
        _require_keys_inside(config)
    out.parent.mkdir(parents=True, exist_ok=True)
    with _workplace(out.parent, config.name, genesis.chain_id.hex()) as own:
        making = own / out.name
        for folder in (making, making / NODE):
            folder.mkdir(mode=0o700)
        write_new_file(making / NODE / CONFIG_FILE, _settings_without_password(config))
        if _require_genesis_name(config):
            _copy(config.genesis_path, making / NODE / config.genesis_path.name)
        if with_keys:
            tell("keys")
            _copy_all(config.data_dir / KEYS, making / KEYS)
        if config.custodian_key_path is not None:
            tell("custody")
            if config.custody_store == "sqlite":
                _copy_database(config.custody_dir / DATABASE_FILE_NAME, making / CUSTODY_DATABASE)
            if (config.custody_dir / PLACE_FILE_NAME).is_file():
                _copy(config.custody_dir / PLACE_FILE_NAME, making / CUSTODY_PLACE)
        tell("ledger")
        # Last, so that the ledger is not older than what the custodian has followed.
        with LedgerFile(config.ledger_dir) as ledger, ledger.snapshot() as view:
            height = make_snapshot_folder(view, making / LEDGER).height
        files = {path.relative_to(making).as_posix(): _digest(path) for path in _files_of(making)}
        manifest = BackupManifest(
            version=VERSION,
            node=config.name,
            chain_id=genesis.chain_id.hex(),
            height=height,
            made_at_ms=time.time_ns() // 1_000_000,
            files=dict(sorted(files.items())),
        )
        write_new_file(making / MANIFEST_FILE, msgspec.json.format(msgspec.json.encode(manifest)))
        for path in (making, *making.rglob("*")):
            sync_folder(path)  # files, too
        making.rename(out)
        sync_folder(out.parent)
    return manifest


def delete_old(out: Path, made: BackupManifest, keep: int) -> list[Path]:
    """Of this node's backups beside `out`, which was just made, delete the oldest beyond so many, `out` included."""
    found = [(_read_own(place), place) for place in out.parent.iterdir() if place != out]
    others = [
        (other.made_at_ms, place)
        for other, place in found
        if other is not None and (other.node, other.chain_id) == (made.node, made.chain_id)
    ]
    old = [place for _, place in sorted(others, reverse=True)[keep - 1 :]]
    for place in old:
        # By a rename first: what a power cut leaves of it does not look like a backup.
        with _workplace(place.parent, made.node, made.chain_id) as leaving:
            place.rename(leaving / place.name)
    sync_folder(out.parent)
    return sorted(old)


@contextmanager
def _workplace(parent: Path, *name: str) -> Iterator[Path]:
    """A folder of one name, so that the next one finds and removes what a power cut or a kill left of this.

    Raises DATA_DIRECTORY_IN_USE, FILE_EXISTS.
    """
    place = parent / f".{'-'.join(name)}.{HALF_DONE}"
    require_own_folder(place)
    if not (place / LOCK_FILE_NAME).exists() and any(place.iterdir()):
        raise BlockRobotError("FILE_EXISTS", f"{place} was not made by this command: nothing was deleted.")
    lock = DirectoryLock(place)
    try:
        for left in place.iterdir():
            if left.name != LOCK_FILE_NAME:
                shutil.rmtree(left)
        yield place
    finally:
        remove_marked(place, LOCK_FILE_NAME)
        lock.release()


def _read_own(place: Path) -> BackupManifest | None:
    """None unless the folder has what a backup's manifest says, and nothing else."""
    if place.is_symlink() or place.name.startswith("."):
        return None
    try:
        manifest = read_json_as(read_given_file(place / MANIFEST_FILE, JSON_MAX_BYTES), BackupManifest)
        names = {path.relative_to(place).as_posix() for path in _files_of(place)}
    except (TextInvalidError, BlockRobotError, OSError):
        return None
    return manifest if names == {MANIFEST_FILE, *manifest.files} else None


def without_password(store: str) -> str:
    """The address of a custodian's store as a backup may hold it. Raises CONFIGURATION_INVALID."""
    scheme, mark, rest = store.partition("://")
    if not mark:
        return store
    place, question, options = rest.partition("?")
    server, slash, database = place.partition("/")
    user, at, hosts = server.rpartition("@")
    if "@" in database + options:
        raise BlockRobotError(
            "CONFIGURATION_INVALID", "[custody] store: write / ? and @ in a password as %2F, %3F, %40."
        )
    kept = "&".join(f"{name}={value}" for name, value in _options_of(store) if _is_harmless(name, value))
    return f"{scheme}://{user.partition(':')[0]}{at}{hosts}{slash}{database}{question if kept else ''}{kept}"


def _options_of(store: str) -> list[tuple[str, str]]:
    return [(name, value) for name, _, value in (each.partition("=") for each in mongo_options(store) if each)]


def _is_harmless(name: str, value: str) -> bool:
    is_login = name.lower() == "authmechanism"
    return unquote_plus(value) in _MECHANISMS if is_login else _OPTIONS.fullmatch(name) is not None


def _settings_without_password(config: NodeConfig) -> str:
    """node.toml with its comments. Raises CONFIGURATION_INVALID."""
    text = read_given_text(config.data_dir / CONFIG_FILE)
    public = without_password(config.custody_store)
    if public == config.custody_store:
        return text
    text = text.replace(config.custody_store, public)
    if read_toml_text(text)["custody"]["store"] != public:
        raise BlockRobotError(
            "CONFIGURATION_INVALID", "[custody] store holds a password: write it without escapes of TOML."
        )
    return text


def read_backup(place: Path) -> BackupManifest:
    """Check that every file of a backup is there and whole. Raises FILE_UNUSABLE."""
    try:
        manifest = read_json_as(read_given_file(place / MANIFEST_FILE, JSON_MAX_BYTES), BackupManifest)
    except TextInvalidError:
        raise BlockRobotError("FILE_UNUSABLE", f"{place} is no backup of a node.") from None
    if manifest.version != VERSION:
        raise BlockRobotError("FILE_UNUSABLE", f"The backup has version {manifest.version}, not {VERSION}.")
    found = {path.relative_to(place).as_posix(): path for path in _files_of(place)}
    found.pop(MANIFEST_FILE, None)
    for name in sorted({*manifest.files, *found}):
        path = found.get(name)
        if name not in manifest.files or path is None or _digest(path) != manifest.files[name]:
            raise BlockRobotError("FILE_UNUSABLE", f"{place / name} is missing, or is not what was backed up.")
    return manifest


def restore(
    place: Path,
    data_dir: Path,
    *,
    keys: Path | None = None,
    erase_keys: Path | None = None,
    genesis: Genesis | None = None,
    outside: Sequence[Path] = (),
    tell: Tell = lambda _step: None,
) -> Restored:
    """Make a node's data directory of a backup, whole or not at all. Its first start has to be with `--restored`.

    `keys`: the node's keys, if the backup has none; `erase_keys`: the newest that are left of its custodian, without
    which its database could not be read and is left out; `genesis`: that of its network, known from elsewhere; `outside`:
    files and folders of the host that it may use. The ledger is proved from the genesis file on.
    Raises NODE_EXISTS, FILE_UNUSABLE, CONFIGURATION_INVALID, GENESIS_DIFFERS, DATA_DIRECTORY_IN_USE, SNAPSHOT_*.
    """
    manifest = read_backup(place)
    if data_dir.exists():
        raise BlockRobotError("NODE_EXISTS", f"There is something in {data_dir} already.")
    data_dir.parent.mkdir(parents=True, exist_ok=True)
    with _workplace(data_dir.parent, data_dir.name) as own:
        making = own / data_dir.name
        making.mkdir(mode=0o700)
        _copy(place / NODE / CONFIG_FILE, making / CONFIG_FILE)
        if keys is not None or manifest.has(KEYS):
            _copy_all(keys or place / KEYS, making / KEYS)
        config = load_config(making)
        _require_own_paths(config, outside)
        if _require_genesis_name(config):
            _copy(place / NODE / config.genesis_path.name, config.genesis_path)
        for path in _keys_of(config):
            if not path.is_file():
                detail = f"There is no {path.name} of the node: name the folder of its keys with --keys."
                raise BlockRobotError("FILE_UNUSABLE", detail)
        if trouble := read_report(config).trouble:
            raise BlockRobotError("FILE_UNUSABLE", f"The keys are not those of {config.name}. {trouble}")
        own_genesis = load_genesis(config)
        _require_network(own_genesis, manifest, genesis)
        tell("ledger")
        head = restore_ledger(SnapshotFolder(place / LEDGER), own_genesis, config.ledger_dir)
        key_warning = _require_agreed_keys(config, own_genesis)
        has_custody = erase_keys is not None and manifest.has(CUSTODY_DATABASE)
        if erase_keys is not None and config.custodian_key_path is not None:
            tell("custody")
            _copy(erase_keys / ERASE_KEYS_FILE_NAME, config.erase_keys_dir / ERASE_KEYS_FILE_NAME)
        if has_custody:
            _copy(place / CUSTODY_DATABASE, making / CUSTODY_DATABASE)
            distrust(making / CUSTODY_DATABASE)
        if manifest.has(CUSTODY_PLACE):
            _copy(place / CUSTODY_PLACE, making / CUSTODY_PLACE)
            _make_own_clips_folder(config)
        making.rename(data_dir)
    config = load_config(data_dir)
    warning = " ".join(filter(None, (key_warning, warn_of_restored(config))))
    return Restored(config, own_genesis, head.header.height, has_custody, warning)


def _make_own_clips_folder(config: NodeConfig) -> None:
    """No backup has one: to the custodian it is a lost place, to be filled again."""
    folder = config.clips_dir
    if folder is None or not folder.resolve().is_relative_to(config.data_dir.resolve()) or folder.exists():
        return
    folder.mkdir(mode=0o700, parents=True)
    write_synced(folder / OWNER_NAME, b"")


def warn_of_restored(config: NodeConfig) -> str:
    """What a start with `--restored` would do to a network that needs each of its producers, as this one; else empty."""
    if config.producer_key_path is None:
        return ""
    try:
        with LedgerFile(config.ledger_dir) as ledger, ledger.snapshot() as view:
            schedule = Schedule.of(read_epoch(view))
        key = load_key(config.producer_key_path, None, "producer").public_key
    except BlockRobotError:
        return ""
    if key not in schedule.producers or schedule.faults_tolerated or len(schedule.producers) == 1:
        return ""
    return (
        f"It is one of {len(schedule.producers)} producers, and all of them are needed: with --restored it is locked out "
        "for good, and nothing becomes final any more. If the data directory of its last run is left, with its journal, "
        "use that instead, without --restored; else the organisations have to begin a new network: "
        "docs/how-to/restore-a-backup.md."
    )


def _require_agreed_keys(config: NodeConfig, genesis: Genesis) -> str:
    """A producer's key may have been replaced since the backup: a warning, if it is no other node's.

    Raises FILE_UNUSABLE, CONFIGURATION_INVALID.
    """
    nodes, warning = newest_directory(genesis, [config]).nodes, ""
    for role in ("producer", "custodian"):
        path = getattr(config, f"{role}_key_path")
        if path is None:
            continue
        key = load_key(path, None, role).public_key
        holders = [node.name for node in nodes.values() if key in (node.producer_key, node.custodian_key)]
        agreed = getattr(nodes.get(config.name), f"{role}_key", b"") or key
        if key != agreed and role == "producer" and not holders:
            warning = "Its producer key is not the one in the backup's ledger: right only if it was replaced since."
        elif key != agreed or holders not in ([], [config.name]):
            whose = f": it is that of {holders[0]}" if holders else ""
            detail = f"The {role} key is not that of {config.name} by the backup's ledger{whose}."
            raise BlockRobotError("FILE_UNUSABLE", detail)
    return warning


def _require_own_paths(config: NodeConfig, outside: Sequence[Path]) -> None:
    """A backup may have been changed: its node uses nothing of the host's unasked. Raises CONFIGURATION_INVALID."""
    for name, value in _options_of(config.custody_store):
        if not _is_harmless(name, value):
            detail = (
                f"The backup's {CONFIG_FILE} has {name} in [custody] store, which no backup holds: it may hand credentials "
                "of this host to a database, or read what is not the node's."
            )
            raise BlockRobotError("CONFIGURATION_INVALID", detail)
    allowed = [place.resolve() for place in (config.data_dir, *outside)]
    for path in _paths_of(config):
        if not any(path.resolve().is_relative_to(place) for place in allowed):
            detail = (
                f"The backup's {CONFIG_FILE} names {path}, outside of the node's folder. If it may: --outside {path}."
            )
            raise BlockRobotError("CONFIGURATION_INVALID", detail)


def _paths_of(config: NodeConfig) -> Iterator[Path]:
    """All that `node.toml` names, also in the address of a MongoDB server."""
    named = {**_fields_of(config), **({} if config.clips is None else _fields_of(config.clips))}
    yield from (value for value in named.values() if isinstance(value, Path))
    for option, value in _options_of(config.custody_store):
        if option.lower().endswith("file"):
            yield Path(unquote_plus(value))


def _require_genesis_name(config: NodeConfig) -> bool:
    """Whether the genesis file is beside `node.toml`, under no name that a node looks for. Raises CONFIGURATION_INVALID."""
    path = config.genesis_path
    if path.parent != config.data_dir:
        if path.resolve().is_relative_to(config.data_dir.resolve()):
            detail = f"[node] genesis: put the file beside {CONFIG_FILE}, or outside of the node's folder."
            raise BlockRobotError("CONFIGURATION_INVALID", detail)
        return False
    if path.suffix != ".json" or path.name in (DIRECTORY_FILE, FAULTS_FILE_NAME):
        raise BlockRobotError("CONFIGURATION_INVALID", f"[node] genesis: call the file genesis.json, not {path.name}.")
    return True


def _keys_of(config: NodeConfig) -> Iterator[Path]:
    paths = (config.tls_certificate_path, config.tls_key_path, config.producer_key_path, config.custodian_key_path)
    yield from filter(None, paths)


def _require_keys_inside(config: NodeConfig) -> None:
    """Raises CONFIGURATION_INVALID."""
    for path in _keys_of(config):
        if not path.resolve().is_relative_to((config.data_dir / KEYS).resolve()):
            detail = (
                f"{path} is not in the node's folder {KEYS}/: keep a copy of it elsewhere, and leave --with-keys out."
            )
            raise BlockRobotError("CONFIGURATION_INVALID", detail)


def _require_network(found: Genesis, manifest: BackupManifest, known: Genesis | None) -> None:
    """Raises FILE_UNUSABLE, GENESIS_DIFFERS."""
    if found.chain_id.hex() != manifest.chain_id:
        raise BlockRobotError("FILE_UNUSABLE", "The backup's genesis file is not that of the network that it is of.")
    if known is not None and found.chain_id != known.chain_id:
        raise BlockRobotError(
            "GENESIS_DIFFERS", "The backup is of another network than the genesis file that you name."
        )


def _fields_of(config: NodeConfig | ClipsPlace) -> dict[str, Any]:
    return {field.name: getattr(config, field.name) for field in dataclasses.fields(config)}


def shown_settings(config: NodeConfig) -> dict[str, str | int | bool | list[str]]:
    """What a node was set to, with the paths that leave its folder, and without the password of a database."""
    home = config.data_dir.resolve()
    shown = {
        name: str(value) if isinstance(value, Path) else value
        for name, value in _fields_of(config).items()
        if value is not None and not (isinstance(value, Path) and value.resolve().is_relative_to(home))
    }
    if config.clips is not None:
        clips = config.clips
        paths = {"with keys of": clips.credentials_path, "checked by": clips.ca_path}
        parts = [f"{word} {config.name_of(path)}" for word, path in paths.items() if path is not None]
        shown["clips"] = ", ".join([" at ".join(filter(None, (clips.url, clips.endpoint))), *parts])
    if config.custody_store != "sqlite":
        shown["custody_store"] = without_password(config.custody_store)
    return {name: list(value) if isinstance(value, tuple) else value for name, value in shown.items()}


def unusual_settings(config: NodeConfig) -> dict[str, str | int | bool | list[str]]:
    """Those that are not the default, and all that have none."""
    usual = {field.name: field.default for field in dataclasses.fields(config)} | {"host": LOOPBACK}
    own = _fields_of(config)
    return {name: value for name, value in shown_settings(config).items() if own[name] != usual[name]}


def _files_of(place: Path) -> Iterator[Path]:
    """Raises FILE_UNUSABLE for links, or too many; PermissionError."""
    next(place.iterdir(), None)  # where that is not permitted, rglob finds nothing
    for number, path in enumerate(sorted(place.rglob("*"))):
        if path.is_symlink() or number >= FILES_MAX_COUNT:
            raise BlockRobotError("FILE_UNUSABLE", f"{path} is a link, or one file too many.")
        if path.is_file():
            yield path


def _digest(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _copy(source: Path, target: Path) -> None:
    target.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    try:
        with source.open("rb") as file, new_file(target) as copy:
            shutil.copyfileobj(file, copy)
    except FileNotFoundError:
        raise BlockRobotError("FILE_UNUSABLE", f"There is no {source}.") from None


def _copy_all(source: Path, target: Path) -> None:
    if not source.is_dir():
        raise BlockRobotError("FILE_UNUSABLE", f"There is no folder {source}.")
    for path in _files_of(source):
        _copy(path, target / path.relative_to(source))


def _copy_database(source: Path, target: Path) -> None:
    """As it is now, without what lies in its free pages. Raises STORAGE_DAMAGED."""
    target.parent.mkdir(mode=0o700)
    try:
        with closing(sqlite3.connect(f"{source.as_uri()}?mode=ro", uri=True, timeout=60)) as database:
            database.execute("VACUUM INTO ?", (str(target),))
    except sqlite3.Error as error:
        raise BlockRobotError("STORAGE_DAMAGED", f"The custodian's database cannot be copied: {error}.") from None
    target.chmod(0o600)

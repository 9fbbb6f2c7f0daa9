"""Replaces a node's ledger by a snapshot's, built beside it; the swap is crash-safe."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from consensus.chain.genesis import Genesis
from consensus.errors import BlockRobotError
from node.snapshot.checking import ProvenHead, require_whole, restore_into, verify_head
from node.snapshot.making import Progress, no_progress
from node.snapshot.snapshot_format import SnapshotSource, read_manifest
from node.storage.ledger_store import Position
from node.storage.lmdb_reader import LedgerFile
from node.storage.lmdb_restore import LmdbRestore
from node.storage.lmdb_store import DATA_FILE_NAME
from node.storage.synced_files import sync_directory

WHOLE_MARK = "restored.whole"


def _incoming(ledger_dir: Path) -> Path:
    return ledger_dir.with_name(ledger_dir.name + ".incoming")


def _replaced(ledger_dir: Path) -> Path:
    return ledger_dir.with_name(ledger_dir.name + ".replaced")


def adopt_restored(ledger_dir: Path) -> None:
    """Finish or clear an interrupted restore, under the data directory's lock. Raises STORAGE_BUSY."""
    incoming, replaced = _incoming(ledger_dir), _replaced(ledger_dir)
    if (incoming / WHOLE_MARK).exists() and _height_in(incoming) > _height_in(ledger_dir):
        if ledger_dir.exists():
            shutil.rmtree(replaced, ignore_errors=True)
            ledger_dir.rename(replaced)
        incoming.rename(ledger_dir)
        sync_directory(ledger_dir.parent)
    elif incoming.exists():
        shutil.rmtree(incoming)
    (ledger_dir / WHOLE_MARK).unlink(missing_ok=True)
    if replaced.exists():
        shutil.rmtree(replaced)


def discard_restored(ledger_dir: Path) -> None:
    shutil.rmtree(_incoming(ledger_dir), ignore_errors=True)


def _height_in(directory: Path) -> int:
    """Raises STORAGE_BUSY."""
    try:
        with LedgerFile(directory) as ledger, ledger.snapshot() as snapshot:
            return -1 if snapshot.position is None else snapshot.position.height
    except BlockRobotError as error:
        if error.code == "STORAGE_BUSY":
            raise
        return -1


def read_stored_position(ledger_dir: Path, genesis: Genesis) -> Position | None:
    """Return a ledger's position, or None. Raises SNAPSHOT_OTHER_CHAIN, DATA_DIRECTORY_INVALID, STORAGE_DAMAGED."""
    if not (ledger_dir / DATA_FILE_NAME).is_file():
        return None
    with LedgerFile(ledger_dir) as ledger, ledger.snapshot() as snapshot:
        if snapshot.position is not None and snapshot.block_height(genesis.block_id) != 0:
            raise BlockRobotError("SNAPSHOT_OTHER_CHAIN", "The ledger here is that of another genesis file.")
        return snapshot.position


def restore_ledger(
    source: SnapshotSource, genesis: Genesis, ledger_dir: Path, progress: Progress = no_progress
) -> ProvenHead:
    """Replace the ledger by a checked snapshot, under the directory lock.

    Raises SNAPSHOT_OLD, DATA_DIRECTORY_IN_USE, or as `restore_into`; the ledger is then unchanged.
    """
    adopt_restored(ledger_dir)
    head = build_aside(source, genesis, ledger_dir, progress)
    adopt_restored(ledger_dir)
    return head


def build_aside(
    source: SnapshotSource,
    genesis: Genesis,
    ledger_dir: Path,
    progress: Progress = no_progress,
    stored: Position | None = None,
) -> ProvenHead:
    """Build a snapshot's ledger beside the current one (at `stored`, maybe in use). Raises as `restore_ledger`."""
    manifest = read_manifest(source.manifest())
    head = verify_head(manifest, genesis)
    position = read_stored_position(ledger_dir, genesis) if stored is None else stored
    if position is not None and position.height >= head.header.height:
        require_whole(source, manifest, progress)  # a damaged one is of no use anywhere: that is the first to know
        raise BlockRobotError(
            "SNAPSHOT_OLD", f"The snapshot ends with block {head.header.height}, the ledger with {position.height}."
        )
    incoming = _incoming(ledger_dir)
    shutil.rmtree(incoming, ignore_errors=True)
    try:
        head = restore_into(source, genesis, LmdbRestore(incoming), progress)
        _mark_whole(incoming)
    except BaseException:
        shutil.rmtree(incoming, ignore_errors=True)
        raise
    return head


def _mark_whole(directory: Path) -> None:
    with (directory / WHOLE_MARK).open("wb") as file:
        os.fsync(file.fileno())
    sync_directory(directory)

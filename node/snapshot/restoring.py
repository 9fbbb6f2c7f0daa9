"""Puts a snapshot in the place of a node's ledger.

The new ledger is made beside the old one. A mark says that it is whole; only then do the two change places, and a crash
in between is finished at the next start.
"""

from __future__ import annotations

import os
import shutil
from pathlib import Path

from consensus.chain.genesis import Genesis
from consensus.errors import BlockRobotError
from node.snapshot.checking import ProvenHead, require_whole, restore_into, verify_head
from node.snapshot.form import SnapshotSource, read_manifest
from node.snapshot.making import Progress, no_progress
from node.storage.ledger_store import Position
from node.storage.lmdb_reader import LedgerFile
from node.storage.lmdb_restore import LmdbRestore
from node.storage.lmdb_store import DATA_FILE_NAME, sync_directory

WHOLE_MARK = "restored.whole"


def _incoming(ledger_dir: Path) -> Path:
    return ledger_dir.with_name(ledger_dir.name + ".incoming")


def _replaced(ledger_dir: Path) -> Path:
    return ledger_dir.with_name(ledger_dir.name + ".replaced")


def adopt_restored(ledger_dir: Path) -> None:
    """Finish, or clear away, what a restore that was cut off left. Only for who holds the data directory's lock.

    A ledger that is not newer than the one in place is cleared away too: the node went on by itself meanwhile. Raises
    STORAGE_BUSY.
    """
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
    """Remove a ledger that `build_aside` made and that nobody wants any more."""
    shutil.rmtree(_incoming(ledger_dir), ignore_errors=True)


def _height_in(directory: Path) -> int:
    """Return how far the ledger in a directory is; -1 if there is none that can be read. Raises STORAGE_BUSY."""
    try:
        with LedgerFile(directory) as ledger, ledger.snapshot() as snapshot:
            return -1 if snapshot.position is None else snapshot.position.height
    except BlockRobotError as error:
        if error.code == "STORAGE_BUSY":
            raise
        return -1


def read_stored_position(ledger_dir: Path, genesis: Genesis) -> Position | None:
    """Return the position of the ledger in a directory, or None if there is none.

    Raises SNAPSHOT_OTHER_CHAIN if it is that of another genesis file, DATA_DIRECTORY_INVALID, STORAGE_DAMAGED.
    """
    if not (ledger_dir / DATA_FILE_NAME).is_file():
        return None
    with LedgerFile(ledger_dir) as ledger, ledger.snapshot() as snapshot:
        if snapshot.position is not None and snapshot.block_height(genesis.block_id) != 0:
            raise BlockRobotError("SNAPSHOT_OTHER_CHAIN", "The ledger here is that of another genesis file.")
        return snapshot.position


def restore_ledger(
    source: SnapshotSource, genesis: Genesis, ledger_dir: Path, progress: Progress = no_progress
) -> ProvenHead:
    """Check a snapshot and put it in the ledger's place; return its block. The data directory's lock must be held.

    Raises SNAPSHOT_OLD if the ledger there is as new, what `restore_into` raises, and DATA_DIRECTORY_IN_USE.
    After an error the ledger is as it was.
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
    """Check a snapshot and build a ledger of it beside the one there, which may be in use: `stored` is where it is.

    `adopt_restored` puts it in its place. Raises as `restore_ledger` does; after an error nothing is left of it.
    """
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

"""Opens the voting journal, also after restoring a backup.

`--restored` first appends a durable mark: the producer is silent until the chain advances (R34, R35). Only then is a
missing or damaged journal recreated.
"""

from __future__ import annotations

from pathlib import Path

import structlog

from consensus.chain.journal_records import encode_restored_record
from consensus.errors import BlockRobotError
from node.consensus.journal import Journal
from node.consensus.journal_disk import Disk, SystemDisk

DAMAGED_SUFFIX = ".damaged"

log = structlog.get_logger(__name__)


def open_journal(path: Path, *, restored: bool = False, disk: Disk | None = None) -> Journal:
    """Open a data directory's journal; `restored`: any part is from a backup.

    Raises JOURNAL_MISSING, JOURNAL_DAMAGED (neither if `restored`), JOURNAL_UNWRITABLE, DATA_DIRECTORY_IN_USE.
    """
    disk = disk or SystemDisk()
    if not restored:
        return Journal.open(path, disk=disk)
    try:
        journal = Journal.open(path, disk=disk)
    except BlockRobotError as error:
        if error.code not in ("JOURNAL_MISSING", "JOURNAL_DAMAGED"):
            raise
        log.warning("journal_made_anew", why=error.code)
        if error.code == "JOURNAL_DAMAGED":
            _set_aside(path, disk)
        return Journal.create(path, disk=disk, records=[encode_restored_record()])
    try:
        journal.append(encode_restored_record())
        journal.sync()
    finally:
        journal.close()
    log.warning("journal_marked_restored")
    return Journal.open(path, disk=disk)


def _set_aside(path: Path, disk: Disk) -> None:
    """Raises JOURNAL_UNWRITABLE."""
    try:
        disk.replace(path, path.with_name(path.name + DAMAGED_SUFFIX))
        disk.sync_directory(path.parent)
    except OSError as error:
        raise BlockRobotError("JOURNAL_UNWRITABLE", f"The disk refuses to rename {path}: {error}.") from error

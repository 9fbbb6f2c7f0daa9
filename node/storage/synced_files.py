"""Files and folders' entries forced to the disk: what was made, renamed or removed lasts after a power cut."""

from __future__ import annotations

import os
import secrets
from pathlib import Path

UNFINISHED = ".unfinished-"
"""How names begin of files that a power cut left behind."""


def sync_directory(directory: Path) -> None:
    descriptor = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_synced(path: Path, content: bytes) -> None:
    """Write a file that only its user may read; replaces another, whole or not at all. Raises OSError."""
    made = path.with_name(f"{UNFINISHED}{secrets.token_hex(8)}")
    try:
        with os.fdopen(os.open(made, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        made.replace(path)
    except BaseException:
        made.unlink(missing_ok=True)
        raise
    sync_directory(path.parent)

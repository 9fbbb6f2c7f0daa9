"""Removes a local network.

Only parts with a network's names are removed, and the folder only if then empty. Networks are created in a marked
temporary folder; the mark is locked while its process lives.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

from clients.sdk.trust_pin import PIN_FILE
from consensus.errors import BlockRobotError

GENESIS_FILE = "genesis.json"
NETWORK_FOLDERS = ("nodes", "organisations")
MAKING_MARK = ".blockrobot-making"
_MARK_TEXT = b"BlockRobot makes a network here.\n"
_CHANCE = re.compile(r"[a-z0-9_]{8}")


def remove_network(directory: Path) -> None:
    """Remove a stopped network's parts, and its folder if then empty.

    Raises DATA_DIRECTORY_INVALID if there is no network, or a part is a symlink elsewhere.
    """
    if not (directory / GENESIS_FILE).is_file():
        raise BlockRobotError("DATA_DIRECTORY_INVALID", f"There is no network in {directory}.")
    parts = [directory / name for name in NETWORK_FOLDERS]
    if any(part.is_symlink() for part in parts):
        raise BlockRobotError(
            "DATA_DIRECTORY_INVALID", f"A folder of the network in {directory} is a link: not removed."
        )
    for part in parts:
        if part.is_dir():
            shutil.rmtree(part)
    for name in (PIN_FILE, MAKING_MARK):
        (directory / name).unlink(missing_ok=True)
    (directory / GENESIS_FILE).unlink()  # last: until then the folder is still known for what it is
    if not any(directory.iterdir()):
        directory.rmdir()


@contextlib.contextmanager
def marked_as_making(folder: Path) -> Iterator[None]:
    """Mark an empty folder as under construction; the mark follows a rename."""
    mark = folder / MAKING_MARK
    with mark.open("xb", buffering=0) as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        file.write(_MARK_TEXT)  # behind the lock: a mark with its text and without a lock has no maker any more
        yield


def remove_abandoned(directory: Path) -> None:
    """Remove a killed creation's remains.

    Only a neighbour named `.NAME.` plus eight characters, with an unlocked mark and only network parts.
    """
    prefix = f".{directory.name}."
    for place in sorted(directory.parent.iterdir()) if directory.parent.is_dir() else []:
        if place.name.startswith(prefix) and _CHANCE.fullmatch(place.name.removeprefix(prefix)):
            _remove_if_abandoned(place)


def _remove_if_abandoned(place: Path) -> None:
    if place.is_symlink() or not place.is_dir():
        return
    mark, parts = place / MAKING_MARK, [place / name for name in NETWORK_FOLDERS]
    with contextlib.suppress(OSError):  # no mark, not ours to read, or locked by its living maker: left as it is
        descriptor = os.open(mark, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            is_marked = os.read(descriptor, len(_MARK_TEXT) + 1) == _MARK_TEXT
            holds_more = {item.name for item in place.iterdir()} - {MAKING_MARK, GENESIS_FILE, *NETWORK_FOLDERS}
            if not is_marked or holds_more or any(part.is_symlink() for part in parts):
                return
            for part in parts:
                if part.is_dir():
                    shutil.rmtree(part)
            (place / GENESIS_FILE).unlink(missing_ok=True)
            mark.unlink()
            place.rmdir()
        finally:
            os.close(descriptor)

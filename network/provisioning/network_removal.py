"""Removes a local network.

Only files with a network's names are removed, and folders only if then empty. Networks are created in a marked
temporary folder; the mark is locked while its process lives.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
from collections.abc import Iterator
from pathlib import Path

from consensus.errors import BlockRobotError
from network.provisioning.network_files import find_foreign, remove_marked

GENESIS_FILE = "genesis.json"
NETWORK_FOLDERS = ("nodes", "organisations")
MAKING_MARK = ".blockrobot-making"
_MARK_TEXT = b"BlockRobot makes a network here.\n"
_CHANCE = re.compile(r"[a-z0-9_]{8}")


def remove_network(directory: Path) -> None:
    """Remove a stopped network's files, and its folder if then empty. Whatever else lies there stays.

    Raises DATA_DIRECTORY_INVALID if there is no network, or a part is a symlink elsewhere.
    """
    if not (directory / GENESIS_FILE).is_file():
        raise BlockRobotError("DATA_DIRECTORY_INVALID", f"There is no network in {directory}.")
    parts = [directory / name for name in NETWORK_FOLDERS]
    if any(part.is_symlink() for part in parts):
        raise BlockRobotError(
            "DATA_DIRECTORY_INVALID", f"A folder of the network in {directory} is a link: not removed."
        )
    foreign = set(find_foreign(directory))
    for part in parts:
        for place, _, files in os.walk(part, topdown=False):
            for path in {Path(place, name) for name in files} - foreign:
                path.unlink(missing_ok=True)
            _remove_if_empty(Path(place))
    for path in {path for path in directory.iterdir() if not path.is_dir()} - foreign - {directory / GENESIS_FILE}:
        path.unlink()
    (directory / GENESIS_FILE).unlink()  # last: until then the folder is still known for what it is
    _remove_if_empty(directory)


def _remove_if_empty(folder: Path) -> None:
    if not any(folder.iterdir()):
        folder.rmdir()


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
    mark = place / MAKING_MARK
    with contextlib.suppress(OSError):  # no mark, not ours to read, or locked by its living maker: left as it is
        descriptor = os.open(mark, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            is_marked = os.read(descriptor, len(_MARK_TEXT) + 1) == _MARK_TEXT
            if is_marked and not any(find_foreign(place)):
                remove_marked(place, MAKING_MARK)
        finally:
            os.close(descriptor)

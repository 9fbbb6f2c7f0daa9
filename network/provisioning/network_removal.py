"""Removes a local network again.

A folder is only ever emptied of parts that have a network's names, and removed itself only if nothing else is in it: the
folder may be one's home, or hold something that nobody can bring back. A network is made in a folder aside, which bears
a mark; the mark is locked by who makes it for as long as that process lives.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

from clients.sdk.trust_pin_file import PIN_FILE
from consensus.errors import BlockRobotError

GENESIS_FILE = "genesis.json"
NETWORK_FOLDERS = ("nodes", "organisations")
MAKING_MARK = ".blockrobot-making"
_MARK_TEXT = b"BlockRobot makes a network here.\n"
_CHANCE = re.compile(r"[a-z0-9_]{8}")


def remove_network(directory: Path) -> None:
    """Remove the parts of a stopped network, and its folder if that is empty then.

    Raises DATA_DIRECTORY_INVALID if there is no network, or if a part of it is a link to somewhere else.
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
    """Mark an empty folder as one in which this process makes a network; the mark goes with it if it is renamed."""
    mark = folder / MAKING_MARK
    with mark.open("xb", buffering=0) as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        file.write(_MARK_TEXT)  # behind the lock: a mark with its text and without a lock has no maker any more
        yield


def remove_abandoned(directory: Path) -> None:
    """Remove what a process that was killed left of the network that it was making for this directory.

    Only a folder beside it that is named `.NAME.` and eight characters, bears the mark, which nobody holds any more, and
    has nothing in it that no network has.
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

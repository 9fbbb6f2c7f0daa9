"""Removes a local network again. Must never delete anything that making and running a network did not put there.

A folder is only ever emptied of parts that have a network's names, and removed itself only if nothing else is in it: the
folder may be one's home, or hold something that nobody can bring back.
"""

from __future__ import annotations

import shutil
from pathlib import Path

from clients.sdk.pin_file import PIN_FILE
from consensus.errors import BlockRobotError

GENESIS_FILE = "genesis.json"
NETWORK_FOLDERS = ("nodes", "organisations")


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
    (directory / PIN_FILE).unlink(missing_ok=True)
    (directory / GENESIS_FILE).unlink()  # last: until then the folder is still known for what it is
    if not any(directory.iterdir()):
        directory.rmdir()

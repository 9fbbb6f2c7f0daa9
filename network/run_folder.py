"""The folder of a demonstration or of experiments: marked, locked while in use, and never emptied of anybody's files."""

from __future__ import annotations

import contextlib
import fcntl
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

from clients.sdk.new_files import open_to_append
from clients.sdk.pictures.picture_names import PICTURE_NAME
from consensus.errors import BlockRobotError
from network.cluster import Cluster
from network.provisioning.network_files import NETWORK_FILES, require_own

_ROBOT = r"robots/robot/"
STAGE_FILES = "|".join(
    (
        r"network/(?:" + NETWORK_FILES + ")",
        r"pictures/[a-z0-9-]+/[0-9a-f]{16,64}/" + PICTURE_NAME,
        r"pictures/[a-z0-9-]+/(?:[0-9a-f]{16,64}/|visit-[0-9a-f]{12}-)(?:contact-sheet\.png|animation\.gif)",
        r"wallets/[a-z0-9-]+\.(?:passphrase|wallet|words|uid)",
        r"wallets/\.[a-z0-9-]+\.wallet\.(?:lock|[0-9a-f]{8})",
        _ROBOT + r"(?:client\.pin|robot\.keys|robot\.lock|roster\.sealed|open-visits|\.tmp-open-visits)",
        _ROBOT + r"(?:\.client\.pin\.[0-9a-f]{8}|spool/(?:\.tmp-)?[\w.-]+\.clip)",
    )
)
"""An expression for the paths of what a network, its people's wallets and its robot write below one folder."""


@contextlib.contextmanager
def reserved_folder(out: Path, mark: str, own: str) -> Iterator[None]:
    """For one run; whose files are those that `own` is an expression for. Raises FOLDER_NOT_EMPTY if foreign or in use."""
    if out.is_symlink() or (out.exists() and not out.is_dir()):
        raise BlockRobotError("FOLDER_NOT_EMPTY", f"{out} is a link or a file.")
    if out.exists() and any(out.iterdir()):
        if not (out / mark).is_file():
            raise BlockRobotError("FOLDER_NOT_EMPTY", f"{out} is not empty and not of an earlier run.")
        require_own(out, re.compile(f"{re.escape(mark)}|{own}"))
    out.mkdir(parents=True, exist_ok=True)
    with open_to_append(out / mark) as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise BlockRobotError("FOLDER_NOT_EMPTY", f"Another run is at work in {out}.") from None
        yield


def empty(folder: Path, mark: str = "") -> None:
    """Stop and remove what an earlier run left in a reserved folder, but for its mark."""
    stop_network(folder / "network")
    for item in folder.iterdir():
        if item.is_dir():
            shutil.rmtree(item)
        elif item.name != mark:
            item.unlink()


def stop_network(network: Path) -> None:
    if (network / "genesis.json").is_file():
        Cluster(network).stop_all()

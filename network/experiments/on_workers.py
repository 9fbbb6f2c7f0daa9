"""An experiment on a cluster's worker: nobody else's on that machine, and its folder comes back."""

from __future__ import annotations

import errno
import io
import socket
import tarfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from consensus.errors import BlockRobotError

RESULTS_MAX_BYTES = 512 << 20
_LOCK_NAME = "\0blockrobot-experiment"  # abstract: gone with the process, and of the machine's network, as ports are
_LOOK_EVERY_S = 1.0


@contextmanager
def only_one_on_this_machine() -> Iterator[None]:
    """Wait until nobody else on this machine has the ports."""
    with socket.socket(socket.AF_UNIX) as lock:
        while True:
            try:
                lock.bind(_LOCK_NAME)
                break
            except OSError as error:
                if error.errno != errno.EADDRINUSE:
                    raise
            time.sleep(_LOOK_EVERY_S)
        yield


def pack_results(folder: Path, max_bytes: int = RESULTS_MAX_BYTES) -> bytes:
    """Raises INTERNAL if there is more."""
    total = sum(path.lstat().st_size for path in folder.rglob("*") if path.is_file())
    if total > max_bytes:
        raise BlockRobotError("INTERNAL", f"An experiment's folder has {total} bytes, more than {max_bytes}.")
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w:gz", compresslevel=1) as archive:
        archive.add(folder, arcname=".")
    return packed.getvalue()


def unpack_results(packed: bytes, folder: Path, max_bytes: int = RESULTS_MAX_BYTES) -> None:
    """Files and folders only. Raises CLUSTER_RESULT_FOREIGN if it is no such folder, or has more."""
    try:
        with tarfile.open(fileobj=io.BytesIO(packed), mode="r:gz") as archive:
            total = 0
            for member in archive:
                total += member.size
                if total > max_bytes or not (member.isreg() or member.isdir()):
                    raise BlockRobotError("CLUSTER_RESULT_FOREIGN")
                archive.extract(member, folder, filter="data")
    except (tarfile.TarError, OSError, EOFError) as error:
        raise BlockRobotError("CLUSTER_RESULT_FOREIGN") from error

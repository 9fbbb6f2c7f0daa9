"""Disk reserve for voting, erasing and pruning, closed to uploads.

An owner with an upload under way may reserve up to half the rest.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from consensus.errors import BlockRobotError
from consensus.limits import MIB_BYTES

RESERVE_DEFAULT_MIB = 1_024


def _free_bytes(folder: Path) -> int:
    try:
        found = os.statvfs(folder)
    except OSError:  # a disk that is gone takes nothing
        return 0
    return found.f_bavail * found.f_frsize


class DiskReserve:
    """Free space of the fuller of two folders' disks, minus a reserve (0: none)."""

    def __init__(self, folder: Path, reserve_mib: int, second: Path | None = None) -> None:
        self._folders = (folder,) if second is None else (folder, second)
        self._held: Counter[bytes] = Counter()
        self.reserve_bytes = reserve_mib * MIB_BYTES

    @property
    def free_bytes(self) -> int:
        return min(map(_free_bytes, self._folders))

    @property
    def is_reached(self) -> bool:
        return self.free_bytes < self.reserve_bytes

    def has_room(self, size_bytes: int) -> bool:
        return not self.reserve_bytes or self.free_bytes - self._held.total() - size_bytes >= self.reserve_bytes

    @contextmanager
    def hold(self, owner: bytes, size_bytes: int) -> Iterator[None]:
        """Raises DISK_RESERVE_REACHED."""
        self._require_share(owner, size_bytes)
        self.require(size_bytes)
        self._held[owner] += size_bytes
        try:
            yield
        finally:
            self._held[owner] -= size_bytes
            if not self._held[owner]:
                del self._held[owner]

    def _require_share(self, owner: bytes, size_bytes: int) -> None:
        own_bytes = self._held[owner]
        room_bytes = self.free_bytes - self.reserve_bytes
        if self.reserve_bytes and own_bytes and 2 * (own_bytes + size_bytes) > room_bytes:
            detail = (
                f"Uploads of one robot on their way may take half of the {room_bytes // MIB_BYTES} MiB that are left."
            )
            raise BlockRobotError("DISK_RESERVE_REACHED", detail, retry_after_s=60)

    def require(self, size_bytes: int = 0) -> None:
        """Raise DISK_RESERVE_REACHED if these bytes would use the reserve."""
        if not self.has_room(size_bytes):
            free_mib, reserve_mib = self.free_bytes // MIB_BYTES, self.reserve_bytes // MIB_BYTES
            held_mib = self._held.total() // MIB_BYTES
            held = f", {held_mib} MiB of it for uploads on their way" if held_mib else ""
            detail = f"{free_mib} MiB are free{held}, and {reserve_mib} MiB are kept back."
            raise BlockRobotError("DISK_RESERVE_REACHED", detail, retry_after_s=60)

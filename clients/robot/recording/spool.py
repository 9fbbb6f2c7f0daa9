"""The robot's spool: sealed clips on disk until their records are final.

One file per clip, encrypted under the spool key. Refused clips lose their name before overwriting, so no later run delivers
them.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from clients.robot.identity.sealed_file import TEMPORARY_PREFIX, read_sealed, seal_content, write_durably
from clients.sdk.new_files import sync_folder
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import Wire, decode, encode
from consensus.records.clips import ClipUpload

SPOOL_MAX_BYTES = 1024 * 1024 * 1024
_SUFFIX = ".clip"


class SpooledClip(Wire, frozen=True):
    """A sealed clip and its record's data; the expiring transaction is signed at delivery.

    `owner`, `ephemeral`, `view_tag`, `purpose` announce the visit; times by robot clock; `person` (32 bytes) and
    `sensor` for the consent check.
    """

    upload: ClipUpload
    owner: bytes
    ephemeral: bytes
    view_tag: int
    purpose: str
    visit_bucket_ms: int
    commitment_root: bytes
    ciphertext_root: bytes
    sealed_metadata: bytes
    bucket_ms: int
    expires_at_ms: int
    frame_count: int
    decided_at_ms: int
    person: bytes
    sensor: str
    captured_from_ms: int
    captured_until_ms: int


def number_of(name: str) -> int:
    """Higher for later clips."""
    return int(name.removesuffix(_SUFFIX))


def count_waiting(folder: Path) -> int:
    return sum(path.stem.isdecimal() for path in folder.glob(f"*{_SUFFIX}"))


@dataclass(frozen=True, slots=True)
class Delivered:
    """A clip whose record is final; times by the robot's wall clock."""

    clip: SpooledClip
    txid: bytes
    submitted_at_ms: int
    final_at_ms: int


class Spool:
    """A folder of sealed clips, oldest first."""

    def __init__(self, folder: Path, key: bytes, *, max_bytes: int = SPOOL_MAX_BYTES) -> None:
        self._folder = folder
        self._key = key
        self._max_bytes = max_bytes
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        for leftover in folder.glob(f"{TEMPORARY_PREFIX}*"):
            _wipe(leftover)
        waiting = (path for path in folder.glob(f"*{_SUFFIX}") if path.stem.isdecimal())
        self._sizes = {path.name: path.stat().st_size for path in waiting}
        self.peak_bytes = self.size_bytes
        self._next = max(map(number_of, self._sizes), default=0) + 1

    @property
    def size_bytes(self) -> int:
        return sum(self._sizes.values())

    def names(self) -> list[str]:
        return sorted(self._sizes)

    def put(self, clip: SpooledClip) -> str:
        """Atomic and durable. Raises SPOOL_FULL."""
        name = f"{self._next:012d}{_SUFFIX}"
        sealed = seal_content(name, self._key, encode(clip))
        if self.size_bytes + len(sealed) > self._max_bytes:
            raise BlockRobotError("SPOOL_FULL", f"The spool holds {self.size_bytes} bytes already.")
        write_durably(self._folder / name, sealed)
        self._sizes[name] = len(sealed)
        self.peak_bytes = max(self.peak_bytes, self.size_bytes)
        self._next += 1
        return name

    def get(self, name: str) -> SpooledClip:
        """Raises SPOOL_DAMAGED."""
        content = read_sealed(self._folder / name, self._key)
        try:
            return decode(content, SpooledClip)
        except (BlockRobotError, ValueError, TypeError):
            # It is as this robot sealed it, so nobody changed it.
            detail = f"The spooled clip {name} is of another version of the robot, which can deliver it."
            raise BlockRobotError("SPOOL_DAMAGED", detail) from None

    def remove(self, name: str) -> None:
        (self._folder / name).unlink(missing_ok=True)
        self._sizes.pop(name, None)

    def destroy(self, name: str) -> None:
        """Overwrite and remove; residues stay sealed to the owner."""
        path = self._folder / name
        doomed = path.with_name(TEMPORARY_PREFIX + name)
        try:
            path.replace(doomed)
            sync_folder(self._folder)
            _wipe(doomed)
            sync_folder(self._folder)
        except FileNotFoundError:
            pass
        except OSError as error:
            raise BlockRobotError("SPOOL_DAMAGED", f"The clip {name} cannot be removed: {error.strerror}.") from None
        self._sizes.pop(name, None)


def _wipe(path: Path) -> None:
    with path.open("r+b") as file:
        file.write(bytes(path.stat().st_size))
        file.flush()
        os.fsync(file.fileno())
    path.unlink()

"""The robot's spool: sealed clips on disk until their records are final.

One file a clip, encrypted under the robot's spool key (the sealed clip alone would still tell when and how much was
recorded), written whole or not at all: temporary file, sync, rename, sync of the folder. A robot that is killed at any
moment finds each clip there once or not at all, and delivers it again; delivery is idempotent. A clip that must not be
recorded loses its name first, so that whatever happens while it is overwritten, no later run takes it for one to deliver.
"""

from __future__ import annotations

import os
from pathlib import Path

from clients.robot.recording.sealed_file import TEMPORARY_PREFIX, read_sealed, seal_content, sync_folder, write_durably
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import Wire, decode, encode
from consensus.records.clips import ClipUpload

SPOOL_MAX_BYTES = 1024 * 1024 * 1024
_SUFFIX = ".clip"


class SpooledClip(Wire, frozen=True):
    """A sealed clip and what its record will say. The transaction is signed at delivery, since it expires.

    `owner` is the visit's owner key; with `ephemeral`, `view_tag` and `purpose` it can still be announced after a
    restart. `decided_at_ms` is when the clip's last frame was decided, `captured_...` when the first and last were
    taken, by the robot's clock.
    `person` (32 bytes, `consent_view`) and `sensor` are what consent is asked for once more before recording.
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
    """Return the number in a clip's name. Of clips that wait the later spooled has the higher."""
    return int(name.removesuffix(_SUFFIX))


def count_waiting(folder: Path) -> int:
    """Return how many clips a spool's folder holds, without its key; 0 if there is no such folder."""
    return sum(path.stem.isdecimal() for path in folder.glob(f"*{_SUFFIX}"))


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
        """The bytes on disk of all waiting clips."""
        return sum(self._sizes.values())

    def names(self) -> list[str]:
        """Return the names of the waiting clips, oldest first."""
        return sorted(self._sizes)

    def put(self, clip: SpooledClip) -> str:
        """Store a clip durably and return its name. Raises SPOOL_FULL; nothing is half-written then."""
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
        """Read a clip. Raises SPOOL_DAMAGED if it was changed, is another's or of another version."""
        content = read_sealed(self._folder / name, self._key)
        try:
            return decode(content, SpooledClip)
        except (BlockRobotError, ValueError, TypeError):
            # It is as this robot sealed it, so nobody changed it.
            told = f"The spooled clip {name} is of another version of the robot, which can deliver it."
            raise BlockRobotError("SPOOL_DAMAGED", told) from None

    def remove(self, name: str) -> None:
        """Forget a delivered clip."""
        (self._folder / name).unlink(missing_ok=True)
        self._sizes.pop(name, None)

    def destroy(self, name: str) -> None:
        """Forget a clip that must not be recorded, and its sealed keys with it: overwritten, then removed.

        What a medium keeps of overwritten blocks is sealed to the clip's owner; the robot cannot open it either.
        """
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
    """Overwrite a file, then remove it."""
    with path.open("r+b") as file:
        file.write(bytes(path.stat().st_size))
        file.flush()
        os.fsync(file.fileno())
    path.unlink()

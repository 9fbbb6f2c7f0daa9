"""The erase-key file: destroyed to erase, never backed up.

Remapping drives may keep overwritten keys.
"""

from __future__ import annotations

import fcntl
import os
import secrets
import struct
import threading
from collections.abc import Iterable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

from consensus.errors import BlockRobotError
from consensus.primitives.hashing import sha256
from consensus.records.envelopes import NONCE_BYTES, open_bytes, seal_bytes
from node.custody.stores.custody_store import FrameRow
from node.process_memory import wipe
from node.storage.synced_files import sync_directory

ERASE_KEYS_FILE_NAME = "erase-keys"
ERASE_KEY_BYTES = 32
PAGE_SLOTS_COUNT = 4096
HEADER_BYTES = 512
FORMAT_VERSION = 1

_MAGIC = b"BRERASEK"
_HEADER = struct.Struct(">8sHHQ16s")
_PAGE_BYTES = PAGE_SLOTS_COUNT * (1 + ERASE_KEY_BYTES)
_FREE, _HELD, _DESTROYED = 0, 1, 2
_ZEROS = bytes(ERASE_KEY_BYTES)


class ErasableKeys(Protocol):
    """A custodian's erase keys, as `Custodian` needs them. Raises ERASE_KEYS_DAMAGED."""

    def allocate(self, count: int) -> list[tuple[int, bytes]]:
        """Return `count` slots with durable random keys; the caller wipes them."""
        ...

    def read(self, slot: int) -> bytes | None:
        """Return a slot's key, or None; the caller wipes it."""
        ...

    def destroy(self, slots: Sequence[int]) -> None:
        """Destroy keys for good; slots without key stay unchanged."""
        ...

    def release(self, slots: Sequence[int]) -> None: ...

    def reconcile(self, in_use: Iterable[int]) -> int: ...

    @property
    def held_count(self) -> int: ...

    def find_unclaimed(self, claimed: bytearray) -> list[int]:
        """Return slots that have a key and no mark, by slot, in `claimed`."""
        ...

    @property
    def capacity_count(self) -> int: ...

    def check_destroyed(self, first: int = 0, count: int | None = None) -> int:
        """Return how many supposedly empty slots still hold bytes, of all or of the pages of so many from `first` on."""
        ...


def wrap_key(erase_key: bytes, record_id: bytes, index: int, sealed_key: bytes) -> bytes:
    """Return a sealed data key wrapped for its record (16 bytes) and index."""
    return seal_bytes(erase_key, secrets.token_bytes(NONCE_BYTES), record_id, index, sealed_key)


def unwrap_key(erase_key: bytes, record_id: bytes, index: int, wrapped_key: bytes) -> bytes:
    """Reverse `wrap_key`. Raises ENVELOPE_INVALID."""
    return open_bytes(erase_key, record_id, index, wrapped_key)


def _damaged(detail: str) -> BlockRobotError:
    return BlockRobotError("ERASE_KEYS_DAMAGED", detail)


class EraseKeys:
    """A custodian's erase-key file (mode 0600), locked; blocking, thread-safe.

    Disk failures raise ERASE_KEYS_DAMAGED; erasures are read back.
    """

    def __init__(self, directory: Path) -> None:
        """Open or make the file. Raises DATA_DIRECTORY_IN_USE, ERASE_KEYS_DAMAGED."""
        directory.mkdir(mode=0o700, parents=True, exist_ok=True)
        self._path = directory / ERASE_KEYS_FILE_NAME
        self._lock = threading.Lock()
        self._file = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            self._take_file_lock()
            if not os.pread(self._file, HEADER_BYTES + 1, 0).strip(b"\x00"):
                self._file_id, self._states = secrets.token_bytes(16), bytearray()
                self._write_header(0)
                sync_directory(directory)
            else:
                self._file_id, self._states = self._read_states()
        except BaseException:
            os.close(self._file)
            raise
        self._free = [slot for slot in range(len(self._states) - 1, -1, -1) if self._states[slot] == _FREE]

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        with self._lock:
            if self._file >= 0:
                os.close(self._file)
                self._file = -1

    def allocate(self, count: int) -> list[tuple[int, bytes]]:
        with self._lock:
            while len(self._free) < count:
                self._grow()
            taken = [(self._free.pop(), secrets.token_bytes(ERASE_KEY_BYTES)) for _ in range(count)]
            for slot, key in taken:
                self._write(key, self._key_offset(slot))
                self._put_state(slot, _HELD)
            self._sync()
        return taken

    def read(self, slot: int) -> bytes | None:
        with self._lock:
            if not 0 <= slot < len(self._states) or self._states[slot] != _HELD:
                return None
            key = self._read(self._key_offset(slot), ERASE_KEY_BYTES)
        return None if key == _ZEROS else key

    def destroy(self, slots: Sequence[int]) -> None:
        """Overwrite keys with random bytes, then zeros, both synced, and verify zeros.

        Idempotent; slots stay unusable until `release`. Raises ERASE_KEYS_DAMAGED.
        """
        with self._lock:
            held = sorted({slot for slot in slots if self._is_known(slot) and self._states[slot] == _HELD})
            for slot in held:
                self._write(secrets.token_bytes(ERASE_KEY_BYTES), self._key_offset(slot))
            self._sync()
            for slot in held:
                self._write(_ZEROS, self._key_offset(slot))
                self._put_state(slot, _DESTROYED)
            self._sync()
            for slot in held:
                if self._read(self._key_offset(slot), ERASE_KEY_BYTES) != _ZEROS:
                    raise _damaged(f"Slot {slot} of the erase-key file still holds bytes after it was overwritten.")

    def release(self, slots: Sequence[int]) -> None:
        with self._lock:
            destroyed = sorted({slot for slot in slots if self._is_known(slot) and self._states[slot] == _DESTROYED})
            for slot in destroyed:
                self._put_state(slot, _FREE)
            self._free.extend(reversed(destroyed))

    def reconcile(self, in_use: Iterable[int]) -> int:
        """Destroy and free slots orphaned by a crash; return how many. Call before serving."""
        kept = bytearray(len(self._states))
        for slot in in_use:
            if self._is_known(slot):
                kept[slot] = True
        orphans = [slot for slot, state in enumerate(self._states) if state != _FREE and not kept[slot]]
        self.destroy(orphans)
        self.release(orphans)
        self._wipe_unheld()
        return len(orphans)

    def _wipe_unheld(self) -> None:
        """Zero unheld slots: `allocate` writes keys before their state."""
        with self._lock:
            dirty = self._find_dirty(0, len(self._states))
            for slot in dirty:
                self._write(_ZEROS, self._key_offset(slot))
            if dirty:
                self._sync()

    @property
    def held_count(self) -> int:
        return self._states.count(_HELD)

    @property
    def held(self) -> list[int]:
        return self.find_unclaimed(bytearray())

    def find_unclaimed(self, claimed: bytearray) -> list[int]:
        with self._lock:
            marks = claimed.ljust(len(self._states), b"\x00")
            return [slot for slot, state in enumerate(self._states) if state == _HELD and not marks[slot]]

    @property
    def capacity_count(self) -> int:
        return len(self._states)

    def check_destroyed(self, first: int = 0, count: int | None = None) -> int:
        with self._lock:
            end = len(self._states)
            return len(self._find_dirty(first, end if count is None else min(first + count, end)))

    def _find_dirty(self, start: int, end: int) -> list[int]:
        dirty = []
        for first in range(start, end, PAGE_SLOTS_COUNT):
            content = self._read(self._key_offset(first), PAGE_SLOTS_COUNT * ERASE_KEY_BYTES)
            for place in range(PAGE_SLOTS_COUNT):
                key = content[place * ERASE_KEY_BYTES : (place + 1) * ERASE_KEY_BYTES]
                if self._states[first + place] != _HELD and key != _ZEROS:
                    dirty.append(first + place)
                wipe(key)
            wipe(content)
        return dirty

    def _is_known(self, slot: int) -> bool:
        return 0 <= slot < len(self._states)

    def _take_file_lock(self) -> None:
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise BlockRobotError(
                "DATA_DIRECTORY_IN_USE", f"Another process already uses the erase keys in {self._path.parent}."
            ) from None

    def _write_header(self, pages: int) -> None:
        fields = _HEADER.pack(_MAGIC, FORMAT_VERSION, ERASE_KEY_BYTES, pages, self._file_id)
        self._write((fields + sha256(fields)).ljust(HEADER_BYTES, b"\x00"), 0)
        self._sync()

    def _read_states(self) -> tuple[bytes, bytearray]:
        header = os.pread(self._file, HEADER_BYTES, 0)
        fields, rest = header[: _HEADER.size], header[_HEADER.size :]
        if len(header) != HEADER_BYTES or rest != sha256(fields).ljust(len(rest), b"\x00"):
            raise _damaged("The header of the erase-key file is damaged.")
        magic, version, size, pages, file_id = _HEADER.unpack(fields)
        if (magic, version, size) != (_MAGIC, FORMAT_VERSION, ERASE_KEY_BYTES):
            raise _damaged(f"The erase-key file has format {version}, not {FORMAT_VERSION}.")
        length = HEADER_BYTES + pages * _PAGE_BYTES
        if os.fstat(self._file).st_size < length:
            raise _damaged("The erase-key file is shorter than its header says.")
        os.ftruncate(self._file, length)  # a page whose addition was cut off is not counted in the header
        states = bytearray()
        for page in range(pages):
            states += self._read(HEADER_BYTES + page * _PAGE_BYTES, PAGE_SLOTS_COUNT)
        if any(state > _DESTROYED for state in states):
            raise _damaged("The erase-key file holds a slot of an unknown state.")
        return file_id, states

    def _grow(self) -> None:
        first, pages = len(self._states), len(self._states) // PAGE_SLOTS_COUNT
        self._write(bytes(_PAGE_BYTES), HEADER_BYTES + pages * _PAGE_BYTES)
        self._sync()
        self._write_header(pages + 1)
        self._states += bytes(PAGE_SLOTS_COUNT)
        self._free[:0] = range(first + PAGE_SLOTS_COUNT - 1, first - 1, -1)

    def _key_offset(self, slot: int) -> int:
        page, place = divmod(slot, PAGE_SLOTS_COUNT)
        return HEADER_BYTES + page * _PAGE_BYTES + PAGE_SLOTS_COUNT + place * ERASE_KEY_BYTES

    def _put_state(self, slot: int, state: int) -> None:
        page, place = divmod(slot, PAGE_SLOTS_COUNT)
        self._write(bytes((state,)), HEADER_BYTES + page * _PAGE_BYTES + place)
        self._states[slot] = state

    def _write(self, data: bytes, offset: int) -> None:
        try:
            if os.pwrite(self._file, data, offset) != len(data):
                raise _damaged("The erase-key file could not be written: the disk is full.")
        except OSError as error:
            raise _damaged(f"The erase-key file could not be written: {error.strerror}.") from error

    def _read(self, offset: int, size: int) -> bytes:
        try:
            data = os.pread(self._file, size, offset)
        except OSError as error:
            raise _damaged(f"The erase-key file could not be read: {error.strerror}.") from error
        if len(data) != size:
            raise _damaged("The erase-key file ends too early.")
        return data

    def _sync(self) -> None:
        try:
            os.fsync(self._file)
        except OSError as error:
            raise _damaged(f"The erase-key file could not be forced to the medium: {error.strerror}.") from error


def wrap_frames(
    record_id: bytes, frames: Sequence[tuple[int, bytes, bytes]], taken: Sequence[tuple[int, bytes]]
) -> list[FrameRow]:
    return [
        FrameRow(record_id, index, text, wrap_key(erase_key, record_id, index, key), slot)
        for (index, text, key), (slot, erase_key) in zip(frames, taken, strict=True)
    ]


def wipe_keys(taken: Sequence[tuple[int, bytes]]) -> None:
    for _, erase_key in taken:
        wipe(erase_key)

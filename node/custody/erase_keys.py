"""The file of erase keys: what a custodian must have to open anything, and what it destroys to erase. Must never be copied.

It lies outside the database and its backups. Layout, integers big-endian: a header of 512 bytes (magic, format version,
slot size, number of pages, random id of the file, SHA-256 of these), then pages of 4,096 slots: one state byte for each
slot, then the slots of 32 bytes. A page is added at a time. States: 0 free, 1 holds a key, 2 destroyed and not yet free
again (its frame's row may still be there, and a repeated erasure must not hit another frame's key).
Keys are read from the file when they are needed, and wiped from memory right after. Stated limits: a drive that remaps
blocks and snapshots of the file system can keep what was overwritten.
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
from node.process_memory import wipe

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
    """Where a custodian's erase keys are: what `Custodian` needs of `EraseKeys`. Raises ERASE_KEYS_DAMAGED."""

    def allocate(self, count: int) -> list[tuple[int, bytes]]:
        """Return `count` new slots with random keys, which are safe already; the caller wipes the keys after use."""
        ...

    def read(self, slot: int) -> bytes | None:
        """Return the key in a slot, or None if it holds none; the caller wipes it after use."""
        ...

    def destroy(self, slots: Sequence[int]) -> None:
        """Destroy keys for good; slots that hold none are left as they are."""
        ...

    def release(self, slots: Sequence[int]) -> None:
        """Let destroyed slots be given out again."""
        ...

    def reconcile(self, in_use: Iterable[int]) -> int:
        """Destroy and free the slots that nothing refers to; return how many."""
        ...

    @property
    def held(self) -> list[int]:
        """The slots that hold a key, sorted."""
        ...

    @property
    def capacity_count(self) -> int:
        """How many slots there are."""
        ...

    def check_destroyed(self) -> int:
        """Read every slot that should hold nothing; return how many still hold bytes."""
        ...


def wrap_key(erase_key: bytes, record_id: bytes, index: int, sealed_key: bytes) -> bytes:
    """Return a frame's sealed data key under an erase key, bound to its record (16 bytes) and index."""
    return seal_bytes(erase_key, secrets.token_bytes(NONCE_BYTES), record_id, index, sealed_key)


def unwrap_key(erase_key: bytes, record_id: bytes, index: int, wrapped_key: bytes) -> bytes:
    """Return the sealed data key of `wrap_key`. Raises ENVELOPE_INVALID for another key, record, frame or bytes."""
    return open_bytes(erase_key, record_id, index, wrapped_key)


def _damaged(detail: str) -> BlockRobotError:
    return BlockRobotError("ERASE_KEYS_DAMAGED", detail)


class EraseKeys:
    """The erase-key file of one custodian, locked for this process while it is open. Calls block; threads may share it.

    Made with mode 0600 in a directory of mode 0700. Disk failures raise ERASE_KEYS_DAMAGED: nothing is erased unless
    the overwritten slot was read back.
    """

    def __init__(self, directory: Path) -> None:
        """Open the file in `directory`, or make it if there is none.

        Raises DATA_DIRECTORY_IN_USE if another process has it, ERASE_KEYS_DAMAGED if header or length are wrong.
        """
        directory.mkdir(mode=0o700, parents=True, exist_ok=True)
        self._path = directory / ERASE_KEYS_FILE_NAME
        self._lock = threading.Lock()
        self._file = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            self._take_file_lock()
            if not os.pread(self._file, HEADER_BYTES + 1, 0).strip(b"\x00"):
                self._file_id, self._states = secrets.token_bytes(16), bytearray()
                self._write_header(0)
                self._sync_directory(directory)
            else:
                self._file_id, self._states = self._read_states()
        except BaseException:
            os.close(self._file)
            raise
        self._free = [slot for slot in range(len(self._states) - 1, -1, -1) if self._states[slot] == _FREE]

    def __enter__(self) -> Self:
        """Return the open file itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the file."""
        self.close()

    def close(self) -> None:
        """Close the file and let go of its lock; closing twice is harmless."""
        with self._lock:
            if self._file >= 0:
                os.close(self._file)
                self._file = -1

    def allocate(self, count: int) -> list[tuple[int, bytes]]:
        """Return `count` new slots with random keys, which are on the medium already."""
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
        """Return the key in a slot, or None if it holds none (it was destroyed, or was never given out)."""
        with self._lock:
            if not 0 <= slot < len(self._states) or self._states[slot] != _HELD:
                return None
            key = self._read(self._key_offset(slot), ERASE_KEY_BYTES)
        return None if key == _ZEROS else key

    def destroy(self, slots: Sequence[int]) -> None:
        """Overwrite keys with random bytes, then with zeros, each forced to the medium, and read back the zeros.

        Slots that hold none are left as they are, so that repeating is harmless. They are not given out again before
        `release`. Raises ERASE_KEYS_DAMAGED if what is read back is not zero.
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
        """Let destroyed slots be given out again: nothing refers to them any more."""
        with self._lock:
            destroyed = sorted({slot for slot in slots if self._is_known(slot) and self._states[slot] == _DESTROYED})
            for slot in destroyed:
                self._put_state(slot, _FREE)
            self._free.extend(reversed(destroyed))

    def reconcile(self, in_use: Iterable[int]) -> int:
        """Destroy and free the slots that nothing refers to, left by a crash; return how many. Call before serving."""
        kept = set(in_use)
        orphans = [slot for slot, state in enumerate(self._states) if state != _FREE and slot not in kept]
        self.destroy(orphans)
        self.release(orphans)
        self._wipe_unheld()
        return len(orphans)

    def _wipe_unheld(self) -> None:
        """Zero what a crash left in slots that hold no key: `allocate` writes a key before it says so."""
        with self._lock:
            dirty = self._find_dirty()
            for slot in dirty:
                self._write(_ZEROS, self._key_offset(slot))
            if dirty:
                self._sync()

    @property
    def held_count(self) -> int:
        """How many slots hold a key."""
        return self._states.count(_HELD)

    @property
    def held(self) -> list[int]:
        """The slots that hold a key, sorted."""
        with self._lock:
            return [slot for slot, state in enumerate(self._states) if state == _HELD]

    @property
    def capacity_count(self) -> int:
        """How many slots there are."""
        return len(self._states)

    def check_destroyed(self) -> int:
        """Read every slot that should hold nothing; return how many still hold bytes."""
        with self._lock:
            return len(self._find_dirty())

    def _find_dirty(self) -> list[int]:
        """Return the slots without a key whose bytes are not zero. The lock is held."""
        dirty = []
        for first in range(0, len(self._states), PAGE_SLOTS_COUNT):
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

    def _sync_directory(self, directory: Path) -> None:
        descriptor = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)

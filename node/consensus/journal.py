"""The voting journal: a producer's records, durable before it sends.

Frames `magic | length | crc | sequence | synced | kind | record`. An unreadable frame later called synced is damage,
else a torn tail. Only `create` makes a journal: recreating one allows double votes.
"""

from __future__ import annotations

import os
import struct
import threading
import zlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import structlog

from consensus.chain.journal_records import encode_restored_record
from consensus.errors import BlockRobotError
from node.consensus.journal_disk import Disk, DiskFile, SystemDisk

RECORD_SIZE_MAX_BYTES = 16 * 1024 * 1024
JOURNAL_SIZE_MAX_BYTES = 512 * 1024 * 1024
KIND_MAX = 255
IDENTITY_SIZE_BYTES = 16
DAMAGED_SUFFIX = ".damaged"

_FILE_MAGIC = b"blockrobot-journal/1\n"
_FILE_HEADER = struct.Struct(f">{len(_FILE_MAGIC)}s{IDENTITY_SIZE_BYTES}sQQI")
_FRAME_MAGIC = b"\xb1JRN"
_FRAME_HEADER = struct.Struct(">4sIIQQB")
_COVERED = struct.Struct(">IQQB")

log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class JournalEntry:
    """An appended record: lifelong sequence, kind (0 to 255), bytes."""

    sequence: int
    kind: int
    record: bytes


def _size_of(record: bytes) -> int:
    return _FRAME_HEADER.size + len(record)


def _frame(identity: bytes, entry: JournalEntry, synced: int) -> bytes:
    covered = _COVERED.pack(len(entry.record), entry.sequence, synced, entry.kind)
    checksum = zlib.crc32(entry.record, zlib.crc32(covered, zlib.crc32(identity)))
    return (
        _FRAME_HEADER.pack(_FRAME_MAGIC, len(entry.record), checksum, entry.sequence, synced, entry.kind) + entry.record
    )


def _read_frame(identity: bytes, data: bytes, offset: int) -> tuple[JournalEntry, int] | None:
    start = offset + _FRAME_HEADER.size
    if start > len(data):
        return None
    magic, length, checksum, sequence, synced, kind = _FRAME_HEADER.unpack_from(data, offset)
    if magic != _FRAME_MAGIC or length > RECORD_SIZE_MAX_BYTES or start + length > len(data):
        return None
    record = data[start : start + length]
    covered = _COVERED.pack(length, sequence, synced, kind)
    if zlib.crc32(record, zlib.crc32(covered, zlib.crc32(identity))) != checksum:
        return None
    return JournalEntry(sequence, kind, record), synced


@dataclass(frozen=True, slots=True)
class _FileHead:
    """A file's start: identity (in every crc), first sequence, newest sequence synced with it."""

    identity: bytes
    first_sequence: int
    synced: int

    def encode(self) -> bytes:
        fields = (_FILE_MAGIC, self.identity, self.first_sequence, self.synced)
        return _FILE_HEADER.pack(*fields, zlib.crc32(_FILE_HEADER.pack(*fields, 0)))

    @classmethod
    def decode(cls, data: bytes, path: Path) -> _FileHead:
        if len(data) >= _FILE_HEADER.size:
            _, identity, first_sequence, synced, _ = _FILE_HEADER.unpack_from(data)
            head = cls(identity, first_sequence, synced)
            if data[: _FILE_HEADER.size] == head.encode():
                return head
        raise BlockRobotError("JOURNAL_DAMAGED", f"The head of the journal {path} cannot be read.")


def _replay(data: bytes, path: Path) -> tuple[_FileHead, list[JournalEntry], int]:
    """Raises JOURNAL_DAMAGED."""
    head = _FileHead.decode(data, path)
    entries: list[JournalEntry] = []
    offset, expected, synced = _FILE_HEADER.size, head.first_sequence, head.synced
    while (found := _read_frame(head.identity, data, offset)) is not None and found[0].sequence == expected:
        entries.append(found[0])
        offset += _FRAME_HEADER.size + len(found[0].record)
        expected += 1
    probe = data.find(_FRAME_MAGIC, offset)
    while probe != -1:
        later = _read_frame(head.identity, data, probe)
        synced = synced if later is None else max(synced, later[1])
        probe = data.find(_FRAME_MAGIC, probe + 1)
    if synced >= expected:
        raise BlockRobotError("JOURNAL_DAMAGED", f"Record {expected} of the journal {path} was synced and is lost.")
    return head, entries, offset


def count_records(path: Path) -> int:
    """Count whole records without a write lock; another process may hold it.

    Raises JOURNAL_MISSING, JOURNAL_DAMAGED, FILE_UNUSABLE.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        raise BlockRobotError("JOURNAL_MISSING", f"There is no journal at {path}.") from None
    except OSError as error:
        raise BlockRobotError("FILE_UNUSABLE", f"{path}: {error.strerror}.") from None
    return len(_replay(data, path)[1])


def _make_content(identity: bytes, first: int, records: list[tuple[int, bytes]]) -> tuple[list[JournalEntry], bytes]:
    entries = [JournalEntry(first + index, kind, record) for index, (kind, record) in enumerate(records)]
    newest = first + len(entries) - 1
    frames = [_frame(identity, entry, newest) for entry in entries]
    return entries, _FileHead(identity, first, newest).encode() + b"".join(frames)


def _write_aside(disk: Disk, path: Path, data: bytes) -> DiskFile:
    file = disk.open(_aside(path), create=True)
    try:
        file.append(data)
        file.sync()
    except BaseException:
        file.close()
        raise
    return file


def _put_in_place(disk: Disk, path: Path) -> None:
    disk.replace(_aside(path), path)
    disk.sync_directory(path.parent)


def _aside(path: Path) -> Path:
    return path.with_name(path.name + ".new")


def _refusal(path: Path, error: OSError) -> BlockRobotError:
    return BlockRobotError("JOURNAL_UNWRITABLE", f"The disk refuses the journal {path}: {error.strerror or error}.")


class Journal:
    """An open journal: `append` buffers; `sync` writes and syncs, in any thread.

    After a failure it refuses everything (JOURNAL_UNWRITABLE) until `recover` or reopening.
    """

    def __init__(
        self, disk: Disk, path: Path, file: DiskFile, identity: bytes, entries: list[JournalEntry], next_sequence: int
    ) -> None:
        """Take over an open, synced file; use `create` or `open`."""
        self._disk = disk
        self._path = path
        self._file = file
        self._identity = identity
        self._entries = tuple(entries)
        self._next_sequence = next_sequence
        self._synced = next_sequence - 1
        self._size_bytes = _FILE_HEADER.size + sum(_size_of(entry.record) for entry in entries)
        self._unwritten: list[JournalEntry] = []
        self._broken = False
        self._closed = False
        self._append_lock = threading.Lock()
        self._write_lock = threading.Lock()

    @classmethod
    def create(
        cls,
        path: Path,
        *,
        disk: Disk | None = None,
        identity: bytes | None = None,
        first_sequence: int = 1,
        records: Sequence[bytes] = (),
    ) -> Journal:
        """`identity` (16 bytes) is random by default.

        Raises DATA_DIRECTORY_INVALID if it exists, JOURNAL_UNWRITABLE.
        """
        disk = disk or SystemDisk()
        identity = os.urandom(IDENTITY_SIZE_BYTES) if identity is None else identity
        if len(identity) != IDENTITY_SIZE_BYTES or first_sequence < 1:
            raise ValueError(f"a journal has an identity of {IDENTITY_SIZE_BYTES} bytes and counts from 1 or more")
        if disk.exists(path):
            raise BlockRobotError("DATA_DIRECTORY_INVALID", f"There is a journal already: {path}.")
        entries, data = _make_content(identity, first_sequence, [(0, record) for record in records])
        try:
            file = _write_aside(disk, path, data)
            try:
                _put_in_place(disk, path)
            except BaseException:
                file.close()
                raise
        except OSError as error:
            raise _refusal(path, error) from error
        return cls(disk, path, file, identity, entries, first_sequence + len(entries))

    @classmethod
    def open(cls, path: Path, *, disk: Disk | None = None) -> Journal:
        """Read its `entries`; a torn tail is cut off.

        Raises JOURNAL_MISSING, JOURNAL_DAMAGED, DATA_DIRECTORY_IN_USE, JOURNAL_UNWRITABLE.
        """
        disk = disk or SystemDisk()
        try:
            file = disk.open(path, create=False)
        except FileNotFoundError as error:
            raise BlockRobotError("JOURNAL_MISSING", f"There is no journal {path}.") from error
        except OSError as error:
            raise _refusal(path, error) from error
        try:
            if disk.exists(_aside(path)):
                disk.remove(_aside(path))
            data = file.read_all()
            head, entries, size_bytes = _replay(data, path)
            if size_bytes < len(data):
                file.truncate(size_bytes)
            file.sync()
        except OSError as error:
            file.close()
            raise _refusal(path, error) from error
        except BaseException:
            file.close()
            raise
        return cls(disk, path, file, head.identity, entries, head.first_sequence + len(entries))

    @property
    def entries(self) -> tuple[JournalEntry, ...]:
        """As found on opening, in order; empty after compaction."""
        return self._entries

    @property
    def next_sequence(self) -> int:
        """It never decreases, even by compaction."""
        return self._next_sequence

    @property
    def synced_sequence(self) -> int:
        return self._synced

    @property
    def size_bytes(self) -> int:
        return self._size_bytes

    def append(self, record: bytes, kind: int = 0) -> int:
        """Buffer a record and return its sequence; durable only after `sync`.

        Raises ValueError for bounds, JOURNAL_UNWRITABLE if broken or full.
        """
        if len(record) > RECORD_SIZE_MAX_BYTES or not 0 <= kind <= KIND_MAX:
            raise ValueError("a journal record is too large, or its kind is not one byte")
        with self._append_lock:
            self._check_usable()
            size_bytes = self._size_bytes + _size_of(record)
            if size_bytes > JOURNAL_SIZE_MAX_BYTES:
                raise BlockRobotError("JOURNAL_UNWRITABLE", f"The journal {self._path} has reached its largest size.")
            entry = JournalEntry(self._next_sequence, kind, bytes(record))
            self._unwritten.append(entry)
            self._size_bytes = size_bytes
            self._next_sequence += 1
            return entry.sequence

    def sync(self) -> int:
        """Return the newest durable sequence.

        Blocks: run beside the event loop. Raises JOURNAL_UNWRITABLE.
        """
        with self._write_lock:
            with self._append_lock:
                self._check_usable()
                entries, self._unwritten = self._unwritten, []
            if entries:
                try:
                    self._file.append(b"".join(_frame(self._identity, entry, self._synced) for entry in entries))
                    self._file.sync()
                except OSError as error:
                    self._broken = True
                    raise _refusal(self._path, error) from error
                self._synced = entries[-1].sequence
            return self._synced

    def compact(self, keep: Iterable[tuple[int, bytes]], *, through: int | None = None) -> None:
        """Replace records up to `through` by these (kind, record), with new sequences.

        Later records (default: unsynced ones) follow, and all is synced. Atomic; blocks on the disk. Raises
        JOURNAL_UNWRITABLE.
        """
        with self._write_lock, self._append_lock:
            self._check_usable()
            try:
                last = self._synced if through is None else through
                written = () if last >= self._synced else _replay(self._file.read_all(), self._path)[1]
                carried = [entry for entry in (*written, *self._unwritten) if entry.sequence > last]
                records = [*keep, *((entry.kind, entry.record) for entry in carried)]
                self._replace_by(records)
            except OSError as error:
                raise _refusal(self._path, error) from error

    def recover(self, keep: Iterable[tuple[int, bytes]]) -> None:
        """Rewrite the journal as these (kind, record), also after a failure.

        Atomic; the old file is not read. `keep` has to cover all appended records. Blocks on the disk. Raises
        JOURNAL_UNWRITABLE.
        """
        with self._write_lock, self._append_lock:
            if self._closed:
                self._check_usable()
            try:
                self._replace_by(list(keep))
            except OSError as error:
                raise _refusal(self._path, error) from error
            self._broken = False

    def _replace_by(self, records: list[tuple[int, bytes]]) -> None:
        entries, data = _make_content(self._identity, self._next_sequence, records)
        newest = self._next_sequence + len(entries) - 1
        if len(data) > JOURNAL_SIZE_MAX_BYTES:
            raise BlockRobotError("JOURNAL_UNWRITABLE", f"The journal {self._path} cannot hold that many records.")
        file = _write_aside(self._disk, self._path, data)
        try:
            _put_in_place(self._disk, self._path)
        except BaseException:
            self._broken = True
            file.close()
            raise
        self._file.close()
        self._file = file
        self._entries = ()
        self._unwritten = []
        self._next_sequence = newest + 1
        self._synced = newest
        self._size_bytes = len(data)

    def close(self) -> None:
        with self._write_lock, self._append_lock:
            self._broken = True
            if not self._closed:
                self._closed = True
                self._file.close()

    def _check_usable(self) -> None:
        if self._broken:
            raise BlockRobotError("JOURNAL_UNWRITABLE", f"The journal {self._path} is closed or failed before.")


def open_journal(path: Path, *, restored: bool = False, disk: Disk | None = None) -> Journal:
    """Open a data directory's journal; `restored`: any part is from a backup.

    Then a durable mark comes first: the producer is locked out until the chain advances (R34, R35). Only so is a missing or
    damaged journal recreated.

    Raises JOURNAL_MISSING, JOURNAL_DAMAGED (neither if `restored`), JOURNAL_UNWRITABLE, DATA_DIRECTORY_IN_USE.
    """
    disk = disk or SystemDisk()
    if not restored:
        return Journal.open(path, disk=disk)
    try:
        journal = Journal.open(path, disk=disk)
    except BlockRobotError as error:
        if error.code not in ("JOURNAL_MISSING", "JOURNAL_DAMAGED"):
            raise
        log.warning("journal_made_anew", why=error.code)
        if error.code == "JOURNAL_DAMAGED":
            _set_aside(path, disk)
        return Journal.create(path, disk=disk, records=[encode_restored_record()])
    try:
        journal.append(encode_restored_record())
        journal.sync()
    finally:
        journal.close()
    log.warning("journal_marked_restored")
    return Journal.open(path, disk=disk)


def _set_aside(path: Path, disk: Disk) -> None:
    """Raises JOURNAL_UNWRITABLE."""
    try:
        disk.replace(path, path.with_name(path.name + DAMAGED_SUFFIX))
        disk.sync_directory(path.parent)
    except OSError as error:
        raise BlockRobotError("JOURNAL_UNWRITABLE", f"The disk refuses to rename {path}: {error}.") from error

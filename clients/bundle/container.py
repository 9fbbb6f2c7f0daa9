"""Canonical ZIP container: uncompressed, contiguous, no extra bytes; other forms are refused."""

from __future__ import annotations

import hashlib
import re
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import BinaryIO

from consensus.errors import BlockRobotError

BUNDLE_MAX_BYTES = (1 << 32) - 1
ENTRIES_MAX_COUNT = 65_000
NAME_MAX_CHARS = 96
_CHUNK_BYTES = 1 << 20
_NAME = re.compile(r"[a-z0-9][a-z0-9./-]*|README\.txt", re.ASCII)
_LOCAL = struct.Struct("<4s5H3I2H")
_CENTRAL = struct.Struct("<4s6H3I5H2I")
_END = struct.Struct("<4s4H2IH")
_LOCAL_MARK, _CENTRAL_MARK, _END_MARK = b"PK\x03\x04", b"PK\x01\x02", b"PK\x05\x06"
_VERSION, _MADE_BY_UNIX = 10, 3 << 8 | 20
_STORED, _NO_FLAGS, _MIDNIGHT, _FIRST_DAY = 0, 0, 0, 0x21
_PLAIN_FILE_0600 = 0o100600 << 16


@dataclass(frozen=True, slots=True)
class Entry:
    """One entry: name, size, CRC-32, SHA-256, and content offset."""

    name: str
    size: int
    crc: int
    sha256: bytes
    start: int


def is_name(name: str) -> bool:
    """Allow lower-case letters and digits, no path escapes."""
    whole = len(name) <= NAME_MAX_CHARS and _NAME.fullmatch(name) is not None
    return whole and all(part not in {"", ".", ".."} for part in name.split("/"))


def _local_header(name: bytes, size: int, crc: int) -> bytes:
    head = (_LOCAL_MARK, _VERSION, _NO_FLAGS, _STORED, _MIDNIGHT, _FIRST_DAY, crc, size, size, len(name), 0)
    return _LOCAL.pack(*head) + name


def _directory(entries: list[Entry]) -> bytes:
    parts, place = [], 0
    for entry in entries:
        name = entry.name.encode()
        parts.append(
            _CENTRAL.pack(
                _CENTRAL_MARK,
                _MADE_BY_UNIX,
                _VERSION,
                _NO_FLAGS,
                _STORED,
                _MIDNIGHT,
                _FIRST_DAY,
                entry.crc,
                entry.size,
                entry.size,
                len(name),
                0,
                0,
                0,
                0,
                _PLAIN_FILE_0600,
                place,
            )
            + name
        )
        place += _LOCAL.size + len(name) + entry.size
    directory = b"".join(parts)
    count = len(entries)
    return directory + _END.pack(_END_MARK, 0, 0, count, count, len(directory), place, 0)


def _too_large(what: str) -> BlockRobotError:
    return BlockRobotError("EXPORT_TOO_LARGE", what)


class BundleWriter:
    """Writes entries into an open file; `finish` ends it."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self._place = 0
        self.entries: list[Entry] = []
        self._names: set[str] = set()

    def add(self, name: str, content: bytes) -> Entry:
        """Raises EXPORT_TOO_LARGE, VALUE_INVALID."""
        if not is_name(name) or name in self._names:
            raise BlockRobotError("VALUE_INVALID", f"No entry of a bundle is called {name!r}, or one is already.")
        if len(self.entries) == ENTRIES_MAX_COUNT:
            raise _too_large(f"A bundle holds at most {ENTRIES_MAX_COUNT} files.")
        header = _local_header(name.encode(), len(content), zlib.crc32(content))
        start = self._place + len(header)
        if start + len(content) + _CENTRAL.size * (len(self.entries) + 2) > BUNDLE_MAX_BYTES - (1 << 24):
            raise _too_large("A bundle has at most 4 GiB.")
        self._file.write(header)
        self._file.write(content)
        self._place = start + len(content)
        entry = Entry(name, len(content), zlib.crc32(content), hashlib.sha256(content).digest(), start)
        self.entries.append(entry)
        self._names.add(name)
        return entry

    def finish(self) -> None:
        self._file.write(_directory(self.entries))


def _invalid(detail: str) -> BlockRobotError:
    return BlockRobotError("BUNDLE_INVALID", detail)


def _take(file: BinaryIO, size: int) -> bytes:
    data = file.read(size)
    if len(data) != size:
        raise _invalid("The file breaks off: it was not copied or downloaded whole.")
    return data


class BundleReader:
    """An open bundle, every byte accounted for."""

    def __init__(self, file: BinaryIO, size: int, heard: Callable[[int, int], None] | None = None) -> None:
        """`heard` gets (bytes read, total). Raises BUNDLE_INVALID."""
        if size > BUNDLE_MAX_BYTES:
            raise _invalid("The file is larger than 4 GiB: no bundle is.")
        self._file = file
        self._size = size
        self._heard = heard or (lambda _done, _of: None)
        file.seek(0)
        self.entries = list(self._read_entries())
        self._by_name = {entry.name: entry for entry in self.entries}
        rest = _directory(self.entries)
        if file.read(len(rest) + 1) != rest:
            raise _invalid("The directory at the end of the file is damaged, or something hides there.")

    def __contains__(self, name: str) -> bool:
        return name in self._by_name

    def _read_entries(self) -> Iterator[Entry]:
        seen: set[str] = set()
        while True:
            place = self._file.tell()
            mark = self._file.read(4)
            if mark == _CENTRAL_MARK:
                self._file.seek(place)
                return
            if mark != _LOCAL_MARK:
                raise _invalid("The file is no bundle, or it breaks off, or something stands between its parts.")
            if len(seen) == ENTRIES_MAX_COUNT:
                raise _invalid(f"The file has more than {ENTRIES_MAX_COUNT} entries.")
            entry = self._read_entry(mark)
            if entry.name in seen:
                raise _invalid(f"The file has two entries called {entry.name}.")
            seen.add(entry.name)
            self._heard(self._file.tell(), self._size)
            yield entry

    def _read_entry(self, mark: bytes) -> Entry:
        head = mark + _take(self._file, _LOCAL.size - 4)
        *_, method, _time, _date, crc, _packed, size, name_length, _extra = _LOCAL.unpack(head)
        if method != _STORED:
            raise _invalid("An entry is compressed: the bundle was packed anew. Check the file as it was exported.")
        if not 0 < name_length <= NAME_MAX_CHARS:
            raise _invalid("An entry's name is missing or too long.")
        raw = _take(self._file, name_length)
        name = raw.decode("ascii", errors="replace")
        if not is_name(name):
            raise _invalid(f"No entry of a bundle is called {name[:NAME_MAX_CHARS]!r}.")
        if head + raw != _local_header(raw, size, crc):
            raise _invalid(f"The entry {name} is not as a bundle has it: the file was packed anew. Check the original.")
        start = self._file.tell()
        if start + size > self._size:
            raise _invalid(f"The file breaks off in {name}: it was not copied or downloaded whole.")
        digest, actual, left = hashlib.sha256(), 0, size
        while left:
            chunk = _take(self._file, min(left, _CHUNK_BYTES))
            digest.update(chunk)
            actual = zlib.crc32(chunk, actual)
            left -= len(chunk)
        if actual != crc:
            raise _invalid(f"The entry {name} is damaged.")
        return Entry(name, size, crc, digest.digest(), start)

    def entry(self, name: str) -> Entry:
        """Raises BUNDLE_INVALID if missing."""
        found = self._by_name.get(name)
        if found is None:
            raise _invalid(f"The bundle lacks {name}.")
        return found

    def read(self, name: str, limit_bytes: int) -> bytes:
        """Raises BUNDLE_INVALID if missing, too large or changed."""
        entry = self.entry(name)
        if entry.size > limit_bytes:
            raise _invalid(f"{name} is larger than the {limit_bytes} bytes that it may have.")
        self._file.seek(entry.start)
        content = _take(self._file, entry.size)
        if hashlib.sha256(content).digest() != entry.sha256:
            raise _invalid(f"{name} changed while it was read.")
        return content

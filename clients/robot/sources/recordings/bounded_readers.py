"""The library's readers, which believe an index that names chunks again and again, and load any YAML."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import TYPE_CHECKING, Any, BinaryIO

from rosbags.interfaces import Connection
from rosbags.rosbag1 import reader as rosbag1
from rosbags.rosbag2 import reader as rosbag2
from rosbags.rosbag2 import storage_mcap, storage_sqlite3

from clients.robot.sources.recordings.budget import RECORD_HELD_BYTES, current_budget
from clients.robot.sources.recordings.metadata import METADATA_MAX_BYTES, BoundedYaml, ForeignMetadataError
from clients.robot.sources.recordings.salvage import BrokenOffError, ros1_fields

if TYPE_CHECKING:
    from collections.abc import Generator

_CHUNK_FIELDS_BYTES = 9 + 40
"""An opcode, a length, and what of a chunk is neither the name of its compression nor its data."""
_INDEX_ENTRY_BYTES = 12
_message_source = storage_mcap.msgsrc


class _OpenedOnce:
    path: Any

    def open(self) -> None:
        current_budget().open_once(self.path)
        super().open()  # type: ignore[misc]


class BoundedDirectoryReader(rosbag2.DirectoryReader):
    """Refuses a metadata.yaml that is larger than any."""

    def open(self) -> None:
        if (self.path / "metadata.yaml").stat().st_size > METADATA_MAX_BYTES:
            raise ForeignMetadataError(f"Its metadata.yaml is larger than {METADATA_MAX_BYTES} bytes.")
        super().open()


class BoundedSqliteReader(_OpenedOnce, storage_sqlite3.Sqlite3Reader):
    """Refuses to be named twice by one metadata.yaml."""


class BoundedMcapReader(_OpenedOnce, storage_mcap.McapReader):
    """Refuses an index whose chunks overlap or lie outside the file."""

    def read_index(self) -> None:
        super().read_index()
        current_budget().count_records(len(self.chunks) + len(self.channels))
        place = self.data_start
        for chunk in sorted(self.chunks, key=lambda chunk: chunk.chunk_start_offset):
            packed = _CHUNK_FIELDS_BYTES + len(chunk.compression) + chunk.compressed_size
            if chunk.chunk_start_offset < place or packed > chunk.chunk_length:
                raise BrokenOffError("Its index names a chunk twice.")
            if chunk.uncompressed_size > current_budget().chunk_max_bytes:
                raise BrokenOffError("Its index tells of a chunk larger than any.")
            place = chunk.chunk_start_offset + chunk.chunk_length
        if place > self.data_end:
            raise BrokenOffError("Its index names a chunk outside the file.")


def _bounded_source(
    chunk: storage_mcap.ChunkInfo, channel_map: dict[int, Connection], start: int, stop: int, bio: BinaryIO
) -> Iterator[storage_mcap.Msg]:
    """The library merges chunks whose times overlap, and holds each whole until its last message is out."""
    messages = _message_source(chunk, channel_map, start, stop, bio)
    yield next(messages)
    budget = current_budget()
    with budget.holding(chunk.uncompressed_size):
        before = budget.records_left
        first = next(messages, None)
        with budget.holding(RECORD_HELD_BYTES * (before - budget.records_left)):
            if first is not None:
                yield first
                yield from messages


class BoundedRos1Reader(rosbag1.Reader):
    """Refuses an index that is larger than its file, or names a chunk or connection twice."""

    def open(self) -> None:
        self._numbers: set[int] = set()
        self._left_bytes = self.path.stat().st_size
        super().open()

    def read_connection(self) -> Connection:
        connection = super().read_connection()
        if connection.id in self._numbers:
            raise BrokenOffError("Its index names a connection twice.")
        self._numbers.add(connection.id)
        return connection

    def read_chunk(self) -> rosbag1.Chunk:
        assert self.bio is not None
        place = self.bio.tell()
        if place in self.chunks:
            raise BrokenOffError("Its index names a chunk twice.")
        chunk = super().read_chunk()
        self._pass_over(place)
        return chunk

    def read_index_data(self, pos: int, indexes: dict[int, list[rosbag1.IndexData]]) -> None:
        assert self.bio is not None
        place = self.bio.tell()
        super().read_index_data(pos, indexes)
        current_budget().count_records((self.bio.tell() - place) // _INDEX_ENTRY_BYTES)
        self._pass_over(place)

    def messages(
        self, connections: Collection[Connection] = (), start: int | None = None, stop: int | None = None
    ) -> Generator[tuple[Connection, int, bytes], None, None]:
        for connection, at_ns, data in super().messages(connections, start, stop):
            current_budget().count_unpacked(len(data))
            yield connection, at_ns, data

    def _pass_over(self, place: int) -> None:
        assert self.bio is not None
        self._left_bytes -= self.bio.tell() - place
        if self._left_bytes < 0:
            raise BrokenOffError("Its chunks overlap, or lie outside the file.")


class _BoundedHeader(rosbag1.Header):
    @classmethod
    def read(cls, src: BinaryIO, expect: rosbag1.RecordType | None = None) -> rosbag1.Header:
        """Read a header of no more fields than recorders write."""
        current_budget().count_records(1)
        header = cls(ros1_fields(rosbag1.read_bytes(src, rosbag1.read_uint32(src))))
        if expect is not None and header.get_uint8("op") != expect:
            raise BrokenOffError("Its index leads to another kind of record.")
        return header


def _no_profiles(_text: object) -> list[Any]:
    """A topic's QoS is YAML as well, in any storage, and nobody asks for it."""
    return []


def bound_readers() -> None:
    """Install this module in the library."""
    found: Any = rosbag2
    found.Reader.STORAGE_PLUGINS.update(
        {"dir": BoundedDirectoryReader, ".mcap": BoundedMcapReader, ".db3": BoundedSqliteReader}
    )
    found.DirectoryReader.STORAGE_PLUGINS.update({"mcap": BoundedMcapReader, "sqlite3": BoundedSqliteReader})
    found.YAML = BoundedYaml
    modules: tuple[Any, ...] = (rosbag2, storage_mcap, storage_sqlite3)
    for module in modules:
        module.parse_qos = _no_profiles
    storage_mcap.msgsrc = _bounded_source  # type: ignore[assignment]
    rosbag1.Header = _BoundedHeader  # type: ignore[misc]

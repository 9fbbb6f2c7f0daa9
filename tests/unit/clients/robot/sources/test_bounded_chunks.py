"""A recording of some kilobytes that says to hold gigabytes is damaged, and costs no more than its reader may use."""

from __future__ import annotations

import bz2
import resource
import struct
import sys
import tempfile
from pathlib import Path

import lz4.frame
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from clients.robot.sources.recordings import bounded_chunks
from clients.robot.sources.recordings.bounded_chunks import ChunkTooLargeError, unpack_bz2, unpack_lz4, unpack_zstd
from clients.robot.sources.recordings.recording import Recording
from consensus.errors import BlockRobotError

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

LIMIT = 1 << 20
PACKERS = {
    "bz2": (bz2.compress, unpack_bz2),
    "lz4": (lz4.frame.compress, unpack_lz4),
    "zstd": (zstd.compress, unpack_zstd),
}


@pytest.fixture
def limit(monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr(bounded_chunks, "CHUNK_MAX_BYTES", LIMIT)
    return LIMIT


@pytest.mark.parametrize("name", PACKERS)
def test_a_chunk_is_unpacked_up_to_the_limit_and_refused_beyond(name: str, limit: int) -> None:
    pack, unpack = PACKERS[name]
    for size in (0, 1, limit):
        assert unpack(pack(bytes(size))) == bytes(size)
    for wrong in (pack(bytes(limit + 1)), pack(bytes(100 * limit)), pack(bytes(1000))[:-1]):
        with pytest.raises(ChunkTooLargeError):
            unpack(wrong)


@pytest.mark.parametrize("name", PACKERS)
def test_a_chunk_of_several_streams_is_unpacked_whole_and_never_in_part(name: str, limit: int) -> None:
    pack, unpack = PACKERS[name]
    assert unpack(pack(b"first") + pack(b"") + pack(b"second")) == b"firstsecond"
    half = pack(bytes(limit // 2))
    assert unpack(half + half) == bytes(limit)
    many = pack(b"") * (bounded_chunks.CHUNK_STREAMS_MAX_COUNT + 1)
    for wrong in (half + half + pack(b"1"), half + half[:-1], many):
        with pytest.raises(ChunkTooLargeError):
            unpack(wrong)
    with pytest.raises((ChunkTooLargeError, OSError, RuntimeError, zstd.ZstdError)):
        unpack(half + b"what no stream begins with")


def _record(fields: dict[str, bytes], data: bytes) -> bytes:
    header = b"".join(
        struct.pack("<I", len(name) + 1 + len(value)) + name.encode() + b"=" + value for name, value in fields.items()
    )
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


@pytest.mark.parametrize("name", ["bz2", "lz4"])
def test_a_bag_of_some_kilobytes_takes_no_gigabytes(tmp_path: Path, name: str, limit: int) -> None:
    pack = PACKERS[name][0]
    packed = pack(bytes(1 << 27))
    path = tmp_path / "bomb.bag"
    index = _record(
        {"op": b"\x03", "index_pos": bytes(8), "conn_count": bytes(4), "chunk_count": bytes(4)}, b" " * 4096
    )
    chunk = _record({"op": b"\x05", "compression": name.encode(), "size": struct.pack("<I", 100)}, packed)
    path.write_bytes(b"#ROSBAG V2.0\n" + index + chunk)
    before_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(BlockRobotError, match="BAG_DAMAGED"):
        list(Recording(path).messages(["/camera"]))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kb < 32 * limit >> 10


def _packed_recording(folder: Path) -> Path:
    """A recording of ROS 2 whose file is packed as a whole: a megabyte of one message in some hundred bytes."""
    store, path = get_typestore(Stores.ROS2_HUMBLE), folder / "packed"
    message = store.types["std_msgs/msg/String"](data="x" * (1 << 20))
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3)
    writer.set_compression(CompressionMode.FILE, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/words", "std_msgs/msg/String", typestore=store)
        writer.write(connection, 1, store.serialize_cdr(message, "std_msgs/msg/String"))
    assert sum(file.stat().st_size for file in path.iterdir()) < 100_000
    return path


def test_a_file_that_is_packed_as_a_whole_is_unpacked_up_to_its_limit_and_refused_beyond(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, places = _packed_recording(tmp_path), tmp_path / "tmp"
    places.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(places))
    recording = Recording(path)
    assert len(list(recording.messages(["/words"]))) == 1
    monkeypatch.setattr(bounded_chunks, "UNPACKED_FILE_MAX_BYTES", 1 << 18)
    for attempt in (lambda: Recording(path), lambda: list(recording.messages(["/words"]))):
        with pytest.raises(BlockRobotError, match="RECORDING_TOO_LARGE"):
            attempt()
    assert list(places.iterdir()) == [], "nothing of it is left on the disk"


def test_unpacking_a_file_leaves_room_on_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = _packed_recording(tmp_path)
    monkeypatch.setattr(bounded_chunks, "UNPACKING_LEAVES_BYTES", 1 << 60)
    with pytest.raises(BlockRobotError, match="RECORDING_TOO_LARGE") as refused:
        Recording(path)
    assert "TMPDIR" in refused.value.next_step

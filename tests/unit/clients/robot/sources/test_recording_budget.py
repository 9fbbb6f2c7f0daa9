"""What a recording of some kilobytes may take: its index is not believed, and what it unpacks to is counted."""

from __future__ import annotations

import bz2
import shutil
import struct
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from clients.robot.sources.recordings import budget
from clients.robot.sources.recordings.budget import RecordingBudget, budget_for
from clients.robot.sources.recordings.recording import Recording
from clients.robot.sources.recordings.topic_listing import list_topics
from consensus.errors import BlockRobotError
from tests.unit.clients.robot.sources.recordings import FORMATS, START_MS, Topic, build, image, record, types

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

MIB = 1 << 20
TOPIC = "/camera/depth/image"
DEFINITION = "uint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data\n"
IMAGE = "sensor_msgs/msg/Image"


class Meter:
    """What the passes over a recording took, by the count of their budgets."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.unpacked_bytes = self.records = self.most_held_bytes = 0
        held = 0
        unpack, count, hold = (
            RecordingBudget.count_unpacked,
            RecordingBudget.count_records,
            RecordingBudget._hold,
        )

        def count_unpacked(one: RecordingBudget, size_bytes: int) -> None:
            self.unpacked_bytes += size_bytes
            unpack(one, size_bytes)

        def count_records(one: RecordingBudget, number: int) -> None:
            self.records += number
            count(one, number)

        def hold_bytes(one: RecordingBudget, size_bytes: int) -> None:
            nonlocal held
            held += size_bytes
            self.most_held_bytes = max(held, self.most_held_bytes)
            hold(one, size_bytes)

        monkeypatch.setattr(RecordingBudget, "count_unpacked", count_unpacked)
        monkeypatch.setattr(RecordingBudget, "count_records", count_records)
        monkeypatch.setattr(RecordingBudget, "_hold", hold_bytes)


@pytest.fixture
def meter(monkeypatch: pytest.MonkeyPatch) -> Meter:
    return Meter(monkeypatch)


def read(path: Path) -> tuple[int, str]:
    """Return how many messages it gave, and the code at which it ended."""
    count = 0
    try:
        recording = Recording(path)
        recording.samples(TOPIC)
        for _ in recording.messages([TOPIC]):
            count += 1
    except BlockRobotError as error:
        return count, error.code
    return count, ""


# MCAP


def _mcap(opcode: int, data: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(data)) + data


def _text(text: str) -> bytes:
    return struct.pack("<I", len(text)) + text.encode()


def _mcap_message(at_ns: int) -> bytes:
    return _mcap(5, struct.pack("<HIQQ", 1, 0, at_ns, 0))


def _mcap_chunk(plain: bytes) -> bytes:
    packed = zstd.compress(plain)
    fields = struct.pack("<QQQI", 0, 9, len(plain), 0) + _text("zstd") + struct.pack("<Q", len(packed))
    return _mcap(6, fields + packed)


def _row(place: int, chunk: bytes, plain_bytes: int) -> bytes:
    times = struct.pack("<QQQQ", 0, 9, place, len(chunk))
    index = struct.pack("<IHQQ", 10, 1, place + len(chunk), 31)
    return _mcap(8, times + index + _text("zstd") + struct.pack("<QQ", len(chunk) - 9 - 44, plain_bytes))


def write_mcap(
    path: Path, plain_chunks: Sequence[bytes], *, rows: Sequence[int] = (), shift: int = 0, silent_topics: int = 0
) -> Path:
    """An MCAP file; `rows` says which chunk each row of its index names; none: it has no index."""
    declared = _mcap(3, struct.pack("<H", 1) + _text(IMAGE) + _text("ros2msg") + _text(DEFINITION))
    declared += _mcap(4, struct.pack("<HH", 1, 1) + _text(TOPIC) + _text("cdr") + bytes(4))
    for number in range(2, 2 + silent_topics):
        declared += _mcap(4, struct.pack("<HH", number, 1) + _text(f"/silent{number}") + _text("cdr") + bytes(4))
    data = b"\x89MCAP0\r\n" + _mcap(1, _text("ros2") + _text("")) + declared
    made = []
    for plain in plain_chunks:
        chunk = _mcap_chunk(plain)
        made.append(_row(len(data) + shift, chunk, len(plain)))
        data += chunk
    start = len(data)
    data += declared + b"".join(made[row] for row in rows)
    data += _mcap(0xB, struct.pack("<QHIIIIQQIHQ", 2, 1, 1, 0, 0, len(rows), 0, 9, 10, 1, 2))
    path.write_bytes(data + _mcap(2, struct.pack("<QQI", start if rows else 0, 0, 0)) + b"\x89MCAP0\r\n")
    return path


def _padded(size_bytes: int) -> bytes:
    return _mcap_message(1) + _mcap_message(2) + _mcap(0x80, bytes(size_bytes))


def test_an_index_that_names_one_chunk_again_and_again_is_not_believed(tmp_path: Path, meter: Meter) -> None:
    path = write_mcap(tmp_path / "again.mcap", [_padded(MIB)], rows=[0] * 1000)
    assert read(path) == (2, ""), "what it holds is read from the front"
    assert meter.unpacked_bytes < 4 * MIB, "once to open it, once for a sample, once to read it"


@pytest.mark.parametrize("by_index", [True, False], ids=["by index", "from the front"])
def test_samples_of_all_topics_take_no_more_than_one_pass(
    tmp_path: Path, meter: Meter, monkeypatch: pytest.MonkeyPatch, by_index: bool
) -> None:
    """A sample is looked for by opening the file anew, and of a silent topic all is read."""
    monkeypatch.setattr(budget, "RECORDS_LEAST_COUNT", 5_000)
    monkeypatch.setattr(budget, "RECORDS_PER_BYTE", 0)
    rows = range(50) if by_index else ()
    path = write_mcap(tmp_path / "topics.mcap", [_padded(100)] * 50, rows=rows, silent_topics=200)
    assert len(list_topics(Recording(path))) == 201
    assert meter.records < 3 * budget.RECORDS_LEAST_COUNT


@pytest.mark.parametrize("shift", [1, 1 << 40])
def test_an_index_that_leads_elsewhere_is_not_believed(tmp_path: Path, meter: Meter, shift: int) -> None:
    path = write_mcap(tmp_path / "off.mcap", [_padded(10), _padded(10)], rows=[0, 1], shift=shift)
    assert read(path) == (4, "")


def test_chunks_that_overlap_in_time_are_held_up_to_a_limit(tmp_path: Path, meter: Meter) -> None:
    path = write_mcap(tmp_path / "many.mcap", [_padded(16 * MIB)] * 20, rows=range(20))
    assert path.stat().st_size < 40_000
    assert read(path)[1] == "RECORDING_TOO_LARGE"
    assert meter.most_held_bytes < budget.HELD_LEAST_BYTES + 18 * MIB
    few = write_mcap(tmp_path / "few.mcap", [_padded(5 * MIB)] * 20, rows=range(20))
    assert read(few) == (40, ""), "twenty chunks of the size that recorders write"


@pytest.mark.parametrize("rows", [[], [0]], ids=["from the front", "by index"])
def test_a_chunk_of_tiny_messages_is_counted_before_anything_is_made_of_them(
    tmp_path: Path, meter: Meter, rows: list[int]
) -> None:
    path = write_mcap(tmp_path / "tiny.mcap", [_mcap_message(1) * 400_000], rows=rows)
    assert path.stat().st_size < 10_000
    assert read(path) == (0, "RECORDING_TOO_LARGE")
    assert meter.records < 4 * (budget.RECORDS_LEAST_COUNT + path.stat().st_size)
    few = write_mcap(tmp_path / "few.mcap", [_mcap_message(1) * 10_000], rows=rows)
    assert read(few) == (10_000, "")


def test_a_chunk_that_is_too_large_for_so_small_a_file_is_not_unpacked(tmp_path: Path, meter: Meter) -> None:
    for rows in ([0], []):
        path = write_mcap(tmp_path / "large.mcap", [_padded(200 * MIB)], rows=rows)
        with pytest.raises(BlockRobotError, match=r"BAG_DAMAGED: .* A chunk .* has more than 128 MiB"):
            Recording(path)
    assert meter.unpacked_bytes < 3 * (budget.HELD_LEAST_BYTES + MIB), "once by index, twice from the front"


# ROS 1


def _fields(fields: dict[str, bytes]) -> bytes:
    return b"".join(
        struct.pack("<I", len(name) + 1 + len(value)) + name.encode() + b"=" + value for name, value in fields.items()
    )


def _ros1(op: int, fields: dict[str, bytes], data: bytes) -> bytes:
    header = _fields({"op": bytes([op]), **fields})
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def _number(value: int) -> bytes:
    return struct.pack("<I", value)


def _time(seconds: int) -> bytes:
    return struct.pack("<II", seconds, 0)


def _ros1_message(seconds: int) -> bytes:
    return _ros1(2, {"conn": _number(0), "time": _time(seconds)}, b"")


MESSAGE_BYTES = len(_ros1_message(0))
_CONNECTION = _ros1(
    7,
    {"conn": _number(0), "topic": TOPIC.encode()},
    _fields({"type": b"sensor_msgs/Image", "md5sum": b"*", "message_definition": DEFINITION.encode()}),
)


def _ros1_chunk(plain: bytes, compression: str, entries: Sequence[tuple[int, int]]) -> bytes:
    packed = bz2.compress(plain) if compression == "bz2" else plain
    rows = b"".join(_time(seconds) + _number(offset) for seconds, offset in entries)
    index = _ros1(4, {"ver": _number(1), "conn": _number(0), "count": _number(len(entries))}, rows)
    return _ros1(5, {"compression": compression.encode(), "size": _number(len(plain))}, packed) + index


def write_ros1(
    path: Path, chunks: Sequence[bytes], *, infos: Sequence[int], connections: Sequence[bytes] = (_CONNECTION,)
) -> Path:
    """A ROS 1 bag; `infos` says which chunk each chunk info names."""
    magic = b"#ROSBAG V2.0\n"

    def begun(index: int) -> bytes:
        counts = {"conn_count": _number(len(connections)), "chunk_count": _number(len(infos))}
        return magic + _ros1(3, {"index_pos": struct.pack("<Q", index), **counts}, b" " * 64)

    data, places = begun(0) + _CONNECTION, []
    for chunk in chunks:
        places.append(len(data))
        data += chunk
    index = len(data)
    data += b"".join(connections)
    for info in infos:
        times = {"start_time": _time(1), "end_time": _time(9)}
        fields = {"ver": _number(1), "chunk_pos": struct.pack("<Q", places[info]), **times, "count": _number(1)}
        data += _ros1(6, fields, bytes(8))
    path.write_bytes(begun(index) + data[len(begun(0)) :])
    return path


def test_a_bag_that_goes_to_and_fro_between_chunks_unpacks_up_to_a_limit(tmp_path: Path, meter: Meter) -> None:
    odd, even = range(1, 41, 2), range(2, 42, 2)

    def places(times: Sequence[int]) -> list[tuple[int, int]]:
        return [(at, place * MESSAGE_BYTES) for place, at in enumerate(times)]

    def bag(name: str, padding_bytes: int) -> Path:
        padded = b"".join(map(_ros1_message, odd)) + bytes(padding_bytes)
        plain = b"".join(map(_ros1_message, even))
        chunks = [_ros1_chunk(padded, "bz2", places(odd)), _ros1_chunk(plain, "none", places(even))]
        return write_ros1(tmp_path / name, chunks, infos=[0, 1])

    path = bag("to-and-fro.bag", 30 * MIB)
    count, code = read(path)
    assert (code, count < 40) == ("RECORDING_TOO_LARGE", True)
    most = budget.UNPACKED_LEAST_BYTES + budget.UNPACKED_PER_BYTE * path.stat().st_size
    assert meter.unpacked_bytes < 2 * most + MIB, "one pass and the samples"
    assert read(bag("few.bag", MIB)) == (40, "")


def test_one_chunk_that_many_chunk_infos_name_is_read_once(
    tmp_path: Path, meter: Meter, monkeypatch: pytest.MonkeyPatch
) -> None:
    chunk = _ros1_chunk(_ros1_message(1), "none", [(1, 0)] * 500)
    assert read(write_ros1(tmp_path / "again.bag", [chunk], infos=[0] * 300)) == (1, "")
    assert meter.records < 2000


def test_a_connection_that_is_named_again_and_again_gives_its_messages_once(tmp_path: Path) -> None:
    chunk = _ros1_chunk(_ros1_message(1), "none", [(1, 0)])
    assert read(write_ros1(tmp_path / "same.bag", [chunk], infos=[0], connections=[_CONNECTION] * 50)) == (1, "")


def test_entries_that_lead_into_a_row_of_connections_are_counted(tmp_path: Path, meter: Meter) -> None:
    """Each entry of the index would be followed through all of them."""
    empty = _ros1(7, {}, b"")
    plain = empty * 5000 + _ros1_message(1)
    chunk = _ros1_chunk(plain, "bz2", [(1, place * len(empty)) for place in range(5000)])
    path = write_ros1(tmp_path / "row.bag", [chunk], infos=[0])
    assert read(path)[1] == "RECORDING_TOO_LARGE"
    assert meter.records < 3 * (budget.RECORDS_LEAST_COUNT + path.stat().st_size)


@pytest.mark.parametrize("index", [True, False], ids=["by index", "from the front"])
def test_a_header_of_endless_fields_is_not_made_into_a_table(tmp_path: Path, index: bool) -> None:
    many = {str(place): b"" for place in range(100_000)}
    plain = _ros1(2, {**many, "conn": _number(0), "time": _time(1)}, b"")
    path = tmp_path / ("fields.bag" if index else "fields.bag.active")
    write_ros1(path, [_ros1_chunk(plain, "bz2", [(1, 0)])], infos=[0])
    assert read(path) == (0, "BAG_DAMAGED")


# Files


def _constant(folder: Path, plugin: StoragePlugin, mode: CompressionMode, count: int) -> Path:
    """Depth frames of a wall, which pack as well as any that a camera gives."""
    store, path = types("ros2", {}), folder / f"{plugin.name}-{mode.name}"
    writer = Writer(path, version=9, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    pixels = np.full((480, 640), 1500, np.uint16)
    with writer:
        connection = writer.add_connection(TOPIC, IMAGE, typestore=store)
        for place in range(count):
            message = build(store, IMAGE, image(pixels, at_ms=START_MS + 33 * place))
            writer.write(connection, START_MS * 1_000_000 + place, bytes(store.serialize_cdr(message, IMAGE)))
    return path


def test_a_file_that_is_packed_as_a_whole_is_unpacked_in_proportion_to_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place = tmp_path / "tmp"
    place.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(place))
    path = _constant(tmp_path, StoragePlugin.SQLITE3, CompressionMode.FILE, 4)
    assert read(path) == (4, "")
    monkeypatch.setattr(budget, "FILES_LEAST_BYTES", MIB)
    monkeypatch.setattr(budget, "FILES_PER_BYTE", 10)
    assert read(path) == (0, "RECORDING_TOO_LARGE")
    assert list(place.iterdir()) == []


@pytest.mark.parametrize("kind", ["mcap", "sqlite3"])
def test_a_file_that_metadata_names_twice_is_read_once(tmp_path: Path, kind: str) -> None:
    path = record(tmp_path / "bag", kind, [Topic(TOPIC, IMAGE, [(0, image(np.ones((2, 2), np.uint16)))])])
    (file,) = [file for file in path.iterdir() if file.suffix != ".yaml"]
    metadata = path / "metadata.yaml"
    line = next(line for line in metadata.read_text().splitlines() if line.strip() == f"- {file.name}")
    metadata.write_text(metadata.read_text().replace(line, "\n".join([line] * 50), 1))
    assert read(path) == (1, "")
    (path / f"link{file.suffix}").symlink_to(file)
    assert read(path) == (0, "BAG_DAMAGED")
    shutil.copy(file, path / f"other{file.suffix}")
    (path / f"link{file.suffix}").unlink()
    assert read(path) == (2, "")


def test_a_walls_depth_frames_leave_nine_tenths_of_each_limit(tmp_path: Path, meter: Meter) -> None:
    """Of what recorders write, nothing packs better."""
    packed = [
        _constant(tmp_path, StoragePlugin.MCAP, CompressionMode.STORAGE, 12),
        _constant(tmp_path, StoragePlugin.SQLITE3, CompressionMode.MESSAGE, 12),
        tmp_path / "wall.bag",
    ]
    store = types("ros1", {})
    writer = Ros1Writer(packed[-1])
    writer.set_compression(Ros1Writer.CompressionFormat.BZ2)
    with writer:
        connection = writer.add_connection(TOPIC, IMAGE, typestore=store)
        message = build(store, IMAGE, image(np.full((480, 640), 1500, np.uint16)))
        for place in range(12):
            data = bytes(store.serialize_ros1(message, IMAGE))
            writer.write(connection, START_MS * 1_000_000 + place, data)
    for path in packed:
        recording = Recording(path)
        meter.unpacked_bytes = meter.records = meter.most_held_bytes = 0
        assert len(list(recording.messages([TOPIC]))) == 12
        whole = budget_for(path)
        assert meter.unpacked_bytes < whole.unpacked_left / 10
        assert meter.records < whole.records_left / 10
        assert meter.most_held_bytes < whole.chunk_max_bytes / 10


@pytest.mark.parametrize("kind", FORMATS)
def test_passes_that_are_broken_off_and_mixed_keep_their_own_count(tmp_path: Path, kind: str) -> None:
    images = [(at, image(np.ones((2, 2), np.uint16))) for at in range(20)]
    recording = Recording(record(tmp_path / "bag", kind, [Topic(TOPIC, IMAGE, images)]))
    next(iter(recording.messages([TOPIC])))
    pairs = list(zip(recording.messages([TOPIC]), recording.messages([TOPIC]), strict=True))
    assert len(pairs) == 20
    assert all(one == other for one, other in pairs)

"""Recordings of every format, whole, cut off, without an index, and damaged: all before the break, then a code."""

from __future__ import annotations

import shutil
import sqlite3
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Ros1Writer

from clients.robot.sources.recordings.recording import Recording
from consensus.errors import BlockRobotError
from tests.unit.clients.robot.sources.recordings import FORMATS, START_MS, Topic, image, record, storage_file

IMAGE = "sensor_msgs/msg/Image"
STRING = "std_msgs/msg/String"
COUNT = 90
DEFINITION = {"my_msgs/msg/Tag": "string epc\nfloat32[] power\nuint8[] raw\nstring[] names"}


@pytest.fixture(scope="module", params=FORMATS)
def recording(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ninety images of 38 kB and as many texts: several chunks or many pages."""
    rng = np.random.default_rng(3)
    images = [
        (i * 33, image(rng.integers(1, 9_000, (120, 160), np.uint16), at_ms=START_MS + i * 33)) for i in range(COUNT)
    ]
    texts = [(i * 33 + 1, {"data": f"tag {i}"}) for i in range(COUNT)]
    topics = [Topic("/depth", IMAGE, images), Topic("/tags", STRING, texts)]
    return record(tmp_path_factory.mktemp("whole") / "recording", request.param, topics)


def copy_of(recording: Path, folder: Path) -> Path:
    target = folder / recording.name
    if recording.is_dir():
        shutil.copytree(recording, target)
    else:
        shutil.copy(recording, target)
    return target


def read_all(
    opened: Recording, topics: tuple[str, ...] = ("/depth", "/tags")
) -> tuple[list[tuple[str, int, bytes]], str]:
    """Return every message up to the end or the break, and the code at which it ended."""
    found: list[tuple[str, int, bytes]] = []
    try:
        found.extend((message.topic, message.at_ns, message.data) for message in opened.messages(topics))
    except BlockRobotError as error:
        return found, error.code
    return found, ""


def test_topics_are_counted_and_read_in_order_of_time(recording: Path) -> None:
    opened = Recording(recording)
    assert {name: (topic.type, topic.count) for name, topic in opened.topics.items()} == {
        "/depth": (IMAGE, COUNT),
        "/tags": (STRING, COUNT),
    }
    assert opened.topics["/depth"].rate_hz == pytest.approx(30.6, abs=0.3)
    found, code = read_all(opened)
    assert code == ""
    assert [at_ns for _, at_ns, _ in found] == sorted(at_ns for _, at_ns, _ in found)
    assert len(found) == 2 * COUNT
    assert [opened.types.decode(message).data for message in opened.messages(["/tags"])] == [
        f"tag {i}" for i in range(COUNT)
    ]


@pytest.mark.parametrize("share", [0.35, 0.6, 0.9])
def test_a_recording_that_is_cut_off_gives_all_before_the_break_and_then_says_so(
    recording: Path, tmp_path: Path, share: float
) -> None:
    whole, _ = read_all(Recording(recording))
    copy = copy_of(recording, tmp_path)
    file = storage_file(copy)
    data = file.read_bytes()
    file.write_bytes(data[: int(len(data) * share)])
    opened = Recording(copy)
    found, code = read_all(opened)
    assert code == "BAG_DAMAGED"
    assert opened.broken
    assert found == whole[: len(found)]
    assert len(found) >= 2 * (COUNT * share - 3)
    assert sum(topic.count for topic in opened.topics.values()) == len(found)


def test_a_recording_without_its_description_is_read_by_its_file(recording: Path, tmp_path: Path) -> None:
    """A recorder that was killed has written no metadata.yaml."""
    whole, _ = read_all(Recording(recording))
    copy = copy_of(recording, tmp_path)
    if copy.is_dir():
        (copy / "metadata.yaml").unlink()
    assert read_all(Recording(copy)) == (whole, "")
    assert read_all(Recording(storage_file(copy))) == (whole, "")


def test_what_a_killed_ros1_recorder_leaves_is_read_to_its_end(tmp_path: Path) -> None:
    """Its file is called .bag.active, says that it has no index, and has no end."""
    texts = [(i, {"data": f"tag {i}"}) for i in range(40)]
    path = record(tmp_path / "recording", "ros1", [Topic("/tags", STRING, texts)])
    data = bytearray(path.read_bytes())
    place = data.index(b"index_pos=") + len(b"index_pos=")
    index = int.from_bytes(data[place : place + 8], "little")
    data[place : place + 8] = bytes(8)
    active = tmp_path / "recording.bag.active"
    active.write_bytes(bytes(data[:index]))
    opened = Recording(active)
    found, _ = read_all(opened)
    assert len(found) == 40
    assert opened.types.decode(next(opened.messages(["/tags"]))).data == "tag 0"


@pytest.mark.parametrize("place", [0.3, 0.5, 0.8])
def test_a_stretch_of_zeros_in_the_middle_ends_in_a_code_and_nothing_false_before_it(
    recording: Path, tmp_path: Path, place: float
) -> None:
    whole, _ = read_all(Recording(recording))
    copy = copy_of(recording, tmp_path)
    file = storage_file(copy)
    data = bytearray(file.read_bytes())
    start = int(len(data) * place)
    data[start : start + 60_000] = bytes(60_000)
    file.write_bytes(bytes(data))
    found, code = read_all(Recording(copy))
    # Without checksums in the file, zeros inside an image are an image; what is not whole never comes.
    assert code in ("", "BAG_DAMAGED")
    assert len(found) >= 2
    assert {(topic, at_ns) for topic, at_ns, _ in found} <= {(topic, at_ns) for topic, at_ns, _ in whole}
    assert {len(data) for topic, _, data in found if topic == "/depth"} <= {len(whole[0][2])}


@pytest.mark.parametrize("name", ["text.mcap", "text.bag", "text.db3", "text.txt", "folder", "empty.mcap"])
def test_what_is_no_recording_is_damaged(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    if name == "folder":
        path.mkdir()
    else:
        path.write_text("" if name.startswith("empty") else "this is not a recording")
    with pytest.raises(BlockRobotError, match="BAG_DAMAGED"):
        Recording(path)


@pytest.mark.parametrize("name", ["missing.mcap", "missing.bag", "missing"])
def test_a_recording_that_is_not_there_is_not_called_damaged(tmp_path: Path, name: str) -> None:
    with pytest.raises(BlockRobotError, match=f"FILE_UNUSABLE: There is no recording at .*{name}"):
        Recording(tmp_path / name)


def test_types_that_the_recording_does_not_define_are_taken_from_the_user(tmp_path: Path) -> None:
    messages = [(0, {"epc": "E1", "power": np.array([1.5], np.float32), "raw": np.array([7], np.uint8)})]
    path = record(tmp_path / "bag", "sqlite3", [Topic("/tags", "my_msgs/msg/Tag", messages)], DEFINITION)
    with sqlite3.connect(storage_file(path)) as base:
        base.execute("DELETE FROM message_definitions")
    base.close()
    assert not Recording(path).types.knows("my_msgs/msg/Tag")
    opened = Recording(path, DEFINITION)
    (message,) = opened.messages(["/tags"])
    assert opened.types.decode(message).epc == "E1"
    assert opened.types.paths("my_msgs/msg/Tag") == ["epc", "power[]", "raw", "names[]"]


def test_a_definition_that_makes_no_sense_is_refused(tmp_path: Path) -> None:
    path = record(tmp_path / "bag", "mcap", [Topic("/tags", STRING, [(0, {"data": "E1"})])])
    with pytest.raises(BlockRobotError, match="TOPICS_INVALID"):
        Recording(path, {"my_msgs/msg/Tag": "string"})


def test_a_message_of_another_type_is_undecodable(recording: Path) -> None:
    opened = Recording(recording)
    message = next(opened.messages(["/tags"]))
    with pytest.raises(BlockRobotError) as refused:
        opened.types.decode(type(message)(message.topic, IMAGE, message.at_ns, message.data))
    assert (refused.value.code, refused.value.context["reason"]) == ("FRAME_INVALID", "undecodable")


@pytest.mark.timeout(20)
def test_a_recording_whose_definition_asks_for_endless_work_is_not_worked_through(tmp_path: Path) -> None:
    """Ten bytes that tell of four thousand million values of nothing."""
    path, name = tmp_path / "evil.bag", "a_msgs/msg/Tag"
    text = f"a_msgs/Nothing[] x\nstring epc\n{'=' * 80}\nMSG: a_msgs/Nothing\n"
    with Ros1Writer(path) as writer:
        tags = writer.add_connection("/tags", name, msgdef=text, md5sum="0" * 32)
        writer.write(tags, START_MS * 1_000_000, b"\xff\xff\xff\xff\2\0\0\0AB")
    recording = Recording(path)
    assert not recording.types.knows(name)
    assert recording.samples("/tags") == []

"""What a recording says of itself in YAML is small and plain, or it is not read: a few bytes of it could ask for hours."""

from __future__ import annotations

import sqlite3
import time
from contextlib import closing
from itertools import pairwise
from pathlib import Path

import pytest
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer

from clients.robot.sources.recordings import metadata
from clients.robot.sources.recordings.recording import Recording
from consensus.errors import BlockRobotError
from tests.unit.clients.robot.sources.recordings import Topic, record, storage_file, types

STRING = "std_msgs/msg/String"
PUBLISHERS_COUNT, TOPICS_COUNT = 3, 20
PROFILE = Qos(
    QosHistory.KEEP_LAST,
    10,
    QosReliability.RELIABLE,
    QosDurability.TRANSIENT_LOCAL,
    QosTime(9_223_372_036, 854_775_807),
    QosTime(9_223_372_036, 854_775_807),
    QosLiveliness.AUTOMATIC,
    QosTime(9_223_372_036, 854_775_807),
    avoid_ros_namespace_conventions=False,
)


def merged(levels: int) -> str:
    """Nested merge keys: each level takes ten times what the last one did."""
    names = "abcdefghijkl"[: levels + 1]
    lines = ["a: &a {k: 1, l: 2, m: 3}"]
    lines += [f"{new}: &{new} {{<<: [{','.join([f'*{old}'] * 9)}]}}" for old, new in pairwise(names)]
    return "\n".join(f"  {line}" for line in lines)


HOSTILE = {
    "merge keys": f"\n{merged(9)}",
    "aliases": "[&a [1, 1], *a, *a]",
    "a merge key without an alias": "{<<: {a: 1}, b: 2}",
    "an anchor": "&a 1",
    "a tag": "!!python/object:os.system 1",
    "a tag of a scalar": "!!binary aGFsbG8=",
    "a list": f"[{'1,' * 500_000}1]",
    "deep lists": "[" * 20_000 + "]" * 20_000,
    "deep lists again and again": f"[{('[' * 40 + ']' * 40 + ',') * 5_000}]",
    "deep maps": "{a: " * 5_000 + "1" + "}" * 5_000,
}
PLAIN = {"quoted": '"&a *a << !b"', "a word with a sign": "a&b*c<<d!e", "words": "{a: '*', b: '&', c: '!'}"}


def folder_of(path: Path, kind: str, more: str) -> Path:
    folder = record(path / "bag", kind, [Topic("/tags", STRING, [(0, {"data": "E1"})])])
    with (folder / "metadata.yaml").open("a", encoding="utf-8") as file:
        file.write(f"custom: {more}\n")
    return folder


def read(path: Path) -> list[int]:
    return [message.at_ns for message in Recording(path).messages(["/tags"])]


@pytest.mark.timeout(60)
@pytest.mark.parametrize("what", HOSTILE)
def test_metadata_that_no_recorder_writes_is_not_read_and_its_messages_are(
    tmp_path: Path, what: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(metadata, "METADATA_NODES_MAX_COUNT", 1_000)
    folder = folder_of(tmp_path, "mcap", HOSTILE[what])
    before = time.process_time()
    assert len(read(folder)) == 1
    storage_file(folder).write_bytes(b"")
    with pytest.raises(BlockRobotError, match=r"metadata\.yaml") as caught:
        Recording(folder)
    assert caught.value.code == "BAG_DAMAGED"
    assert time.process_time() - before < 10


@pytest.mark.parametrize("what", PLAIN)
def test_signs_within_texts_of_metadata_are_read(what: str) -> None:
    assert metadata.read_metadata(f"custom: {PLAIN[what]}\n")


def test_metadata_larger_than_any_is_not_taken_into_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = folder_of(tmp_path, "mcap", "1")
    with (folder / "metadata.yaml").open("r+b") as file:
        file.truncate(6 * 1024**3)
    monkeypatch.setattr(Path, "read_text", lambda *_: pytest.fail("it is read whole"))
    assert len(read(folder)) == 1


def recorded(path: Path, kind: StoragePlugin, version: int) -> Path:
    """Many topics of several publishers each, as a robot of a hundred processes records."""
    store = types("mcap", {})
    with Ros2Writer(path, version=version, storage_plugin=kind) as writer:
        for number in range(TOPICS_COUNT):
            connection = writer.add_connection(
                f"/tags{number or ''}", STRING, typestore=store, offered_qos_profiles=[PROFILE] * PUBLISHERS_COUNT
            )
            data = store.serialize_cdr(store.types[STRING]("E1"), STRING)
            writer.write(connection, number, data)
    return path


@pytest.mark.parametrize("version", [8, 9])
@pytest.mark.parametrize("kind", StoragePlugin)
def test_what_a_robot_with_many_topics_records_is_read_by_its_index(
    tmp_path: Path, kind: StoragePlugin, version: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Recording, "_look_through", lambda *_: pytest.fail("its metadata was refused"))
    folder = recorded(tmp_path / "bag", kind, version)
    size_bytes = (folder / "metadata.yaml").stat().st_size
    assert size_bytes * 20 < metadata.METADATA_MAX_BYTES, "two hundred topics leave half of each limit"
    monkeypatch.setattr(metadata, "METADATA_NODES_MAX_COUNT", metadata.METADATA_NODES_MAX_COUNT // 20)
    for path in (folder, storage_file(folder)):
        assert len(Recording(path).topics) == TOPICS_COUNT
        assert read(path) == [0]


def test_metadata_is_read_once_for_all_passes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = folder_of(tmp_path, "mcap", "1")
    opened = Recording(folder)
    monkeypatch.setattr(metadata.PlainComposer, "compose_node", lambda *_: pytest.fail("it is read once more"))
    assert opened.samples("/tags")
    assert opened.samples("/tags")


@pytest.mark.timeout(60)
@pytest.mark.parametrize("profiles", [f"- history: 1\n{merged(9)}", "[" * 20_000])
@pytest.mark.parametrize("is_folder", [True, False])
def test_profiles_of_a_topic_in_a_database_are_not_read(tmp_path: Path, profiles: str, *, is_folder: bool) -> None:
    folder = folder_of(tmp_path, "sqlite3", "1")
    file = storage_file(folder)
    with closing(sqlite3.connect(file)) as base, base:
        base.execute("UPDATE topics SET offered_qos_profiles = ?", (profiles,))
    before = time.process_time()
    assert len(read(folder if is_folder else file)) == 1
    assert time.process_time() - before < 5


@pytest.mark.timeout(60)
@pytest.mark.parametrize("is_folder", [True, False])
def test_profiles_of_a_topic_in_mcap_are_not_read(tmp_path: Path, *, is_folder: bool) -> None:
    folder = tmp_path / "bag"
    store = types("mcap", {})
    writer = Ros2Writer(folder, version=8, storage_plugin=StoragePlugin.MCAP)
    with writer:
        added = writer.storage.add_connection
        writer.storage.add_connection = lambda connection, _: added(connection, f"- history: 1\n{merged(9)}")
        connection = writer.add_connection("/tags", STRING, typestore=store)
        writer.write(connection, 1, store.serialize_cdr(store.types[STRING]("E1"), STRING))
    before = time.process_time()
    assert read(folder if is_folder else storage_file(folder)) == [1]
    assert time.process_time() - before < 5

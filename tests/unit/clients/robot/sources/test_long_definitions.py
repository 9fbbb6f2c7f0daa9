"""A recording's definitions may be of any length: what is longer than anybody writes is told, and costs no seconds."""

from __future__ import annotations

import struct
import time
from pathlib import Path

import pytest
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_typestore

from clients.robot.sources.messages.message_types import (
    DEFINITION_MAX_CHARS,
    DEFINITION_MAX_WORDS,
    DEFINITIONS_MAX_COUNT,
    DefinitionTooLongError,
    count_work,
)
from clients.robot.sources.recordings import recording as recordings
from clients.robot.sources.recordings.recording import Recording
from clients.robot.sources.recordings.salvage import BrokenOffError, Channel, scan_file

X = "a/msg/X"
MSG, IDL = MessageDefinitionFormat.MSG, MessageDefinitionFormat.IDL
RULE = "=" * 80
HEAD, END = f"{RULE}\nIDL: {X}\n", "module a { module msg { struct X { octet x; }; }; };"
FIELDS = "".join(f"uint8 f{number}\n" for number in range(100_000))
LONG = {
    "fields": ("ros2msg", FIELDS),
    "a word": ("ros2msg", "uint8 " + "a" * 100_000),
    "annotations": ("ros2idl", f"{HEAD}{'@a(b=1) ' * 20_000}{END}"),
    "bounded strings": ("ros2idl", f"{HEAD}{END.replace('octet x;', 'string<9> a; ' * 20_000)}"),
    "comments": ("ros2idl", f"{HEAD}{'// ' * DEFINITION_MAX_CHARS}"),
}


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


def mcap(path: Path, schemas: list[tuple[str, str, str]]) -> Path:
    """Write a file without an index: each type has a topic, and a message of one byte."""
    content = b""

    def record(kind: int, body: bytes) -> None:
        nonlocal content
        content += bytes((kind,)) + struct.pack("<Q", len(body)) + body

    record(1, text("ros2") + text("x"))
    for number, (name, kind, definition) in enumerate(schemas, start=1):
        record(3, struct.pack("<H", number) + text(name) + text(kind) + text(definition))
        record(4, struct.pack("<HH", number, number) + text(f"/t{number}") + text("cdr") + struct.pack("<I", 0))
        record(5, struct.pack("<HIQQ", number, 0, number, number) + b"\0\1\0\0\7")
    record(15, bytes(4))
    path.write_bytes(b"\x89MCAP0\r\n" + content)
    return path


def looked_at(path: Path) -> tuple[Recording, float]:
    before = time.process_time()
    return Recording(path), time.process_time() - before


@pytest.mark.timeout(60)
@pytest.mark.parametrize("what", LONG)
def test_a_definition_that_is_too_long_is_told_and_not_parsed(tmp_path: Path, what: str) -> None:
    found, took_s = looked_at(mcap(tmp_path / "a.mcap", [(X, *LONG[what]), ("a/msg/Y", "ros2msg", "uint8 y")]))
    assert took_s < 2
    assert "longer than anybody writes" in found.broken
    assert not found.types.knows(X)
    assert found.types.knows("a/msg/Y")


@pytest.mark.timeout(60)
@pytest.mark.parametrize("kind", ["ros1", "sqlite3", "mcap"])
def test_a_recording_with_an_index_is_parsed_by_no_one_else(tmp_path: Path, kind: str) -> None:
    """The library's own reader would parse each definition, when it is looked at and again when it is read."""
    path = tmp_path / ("a.bag" if kind == "ros1" else "a")
    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    writer = Ros1Writer(path) if kind == "ros1" else Ros2Writer(path, version=9, storage_plugin=plugin)
    with writer as opened:
        connection = opened.add_connection("/x", X, msgdef=FIELDS, **_sum(kind))
        opened.write(connection, 1, b"\0\1\0\0\7")
    found, took_s = looked_at(path)
    before = time.process_time()
    assert len(list(found.messages(["/x"]))) == 1
    assert took_s + time.process_time() - before < 3
    assert "longer than anybody writes" in found.broken


def _sum(kind: str) -> dict[str, str]:
    return {"md5sum": "0" * 32} if kind == "ros1" else {"rihs01": "RIHS01_" + "0" * 64}


def test_all_definitions_together_are_no_more_work_than_so_much(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = [f"a/msg/T{number}" for number in range(8)]
    path = mcap(tmp_path / "a.mcap", [(name, "ros2msg", "uint8 x\nuint8 y") for name in names])
    assert Recording(path).broken == ""
    for bound, value in (("DEFINITIONS_MAX_WORK", 23), ("DEFINITIONS_MAX_COUNT", 5)):
        with monkeypatch.context() as changed:
            changed.setattr(recordings, bound, value)
            found = Recording(path)
        assert [found.types.knows(name) for name in names] == [True] * 5 + [False] * 3
        if bound == "DEFINITIONS_MAX_WORK":
            assert "longer than anybody writes" in found.broken


def test_types_and_topics_without_end_are_where_a_recording_breaks_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = mcap(tmp_path / "a.mcap", [(f"a/msg/T{number}", "ros2msg", "uint8 x") for number in range(2_000)])
    scan, channels = scan_file(path), []
    with pytest.raises(BrokenOffError, match="more types"):
        channels.extend(item for item in scan if isinstance(item, Channel))
    monkeypatch.setattr(recordings, "CHANNELS_MAX_COUNT", 10)
    found = Recording(path)
    assert len(found.topics) == 10
    assert "more topics" in found.broken
    assert DEFINITIONS_MAX_COUNT < 2_000


@pytest.mark.parametrize("name", sorted(get_typestore(Stores.ROS2_HUMBLE).fielddefs))
def test_what_ros_defines_is_short_enough(name: str) -> None:
    store = get_typestore(Stores.ROS2_HUMBLE)
    definition, _ = store.generate_msgdef(name, ros_version=2)
    assert 0 <= count_work(MessageDefinition(MSG, definition)) < DEFINITION_MAX_WORDS // 2


def test_comments_of_a_message_cost_nothing_and_an_idl_six_times() -> None:
    assert count_work(MessageDefinition(MSG, "# a b\n\n  # c\nuint8 a\n")) == 2
    assert count_work(MessageDefinition(IDL, "uint8 a")) == 12
    with pytest.raises(DefinitionTooLongError):
        count_work(MessageDefinition(MSG, "#" * (DEFINITION_MAX_CHARS + 1)))

"""Making, caching and reading recordings; a damaged one ends in a code of the catalogue, whatever is wrong with it."""

from __future__ import annotations

import os
import random
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from clients.robot.sensing.message_names import DEPTH_TOPIC, IMAGE_TYPE, SIGHTING_TOPIC, SIGHTING_TYPE
from clients.robot.sensing.sensor_events import Facing, Frame, Sighting
from clients.robot.sources.recordings.bag_source import BagSource
from clients.robot.synthetic.bag_messages import MessageCodec
from clients.robot.synthetic.render import Renderer
from clients.robot.synthetic.scenario import Scenario
from clients.robot.synthetic.scenario_bag import RUN_START_MS, make_bag
from consensus.errors import BlockRobotError

UID = "E200000000000001"


class FakeClock:
    """A clock that only moves when someone waits for it."""

    def __init__(self, now_ms: int) -> None:
        self.now = now_ms
        self.waits: list[int] = []

    def now_ms(self) -> int:
        return self.now

    async def sleep_until(self, at_ms: int) -> None:
        self.waits.append(at_ms)
        self.now = max(self.now, at_ms)


def test_the_bag_holds_exactly_what_was_rendered(small_bag: Path, small_scenario: Scenario) -> None:
    events = list(BagSource(small_bag).events())
    frames = [event for event in events if isinstance(event, Frame)]
    renderer = Renderer(small_scenario)
    assert [frame.sequence for frame in frames] == list(range(6))
    for frame in frames:
        assert np.array_equal(frame.depth, renderer.frame(frame.sequence))
    assert [frame.captured_at_ms - RUN_START_MS for frame in frames] == [0, 100, 200, 300, 400, 500]


def test_sightings_come_in_order_and_do_not_print_their_tag(small_bag: Path) -> None:
    seen = [event for event in BagSource(small_bag).events() if isinstance(event, Sighting)]
    assert [event.first_seen_ms - RUN_START_MS for event in seen] == [100, 300, 500]
    assert {event.uid for event in seen} == {UID}
    assert all(event.facing is Facing.FRONT and event.sigma_m == pytest.approx(0.3) for event in seen)
    assert all(event.distance_m is not None and 1 < event.distance_m < 4 for event in seen)
    seen = next(event for event in BagSource(small_bag).events() if isinstance(event, Sighting))
    assert UID not in repr(seen)
    source = BagSource(small_bag)
    assert (source.frame_count, source.sighting_count, source.empty_frame_count) == (6, 3, 3)
    assert len(source.empty_frames()) == 3


async def test_playing_waits_for_each_event_on_the_shifted_timeline(small_bag: Path) -> None:
    source = BagSource(small_bag)
    source.shift_to(1_000_000)
    clock = FakeClock(1_000_000)
    times = [event.captured_at_ms async for event in source.play(clock) if isinstance(event, Frame)]
    assert times == [1_000_000 + 100 * i for i in range(6)]
    assert clock.waits == sorted(clock.waits)
    assert clock.now == 1_000_500


def test_the_same_scene_is_not_rendered_twice(small_bag: Path, small_scenario: Scenario) -> None:
    calls: list[tuple[int, int]] = []
    again = make_bag(small_scenario, {"ann": UID}, small_bag.parent, progress=lambda d, t: calls.append((d, t)))
    assert again == small_bag
    assert calls == [(9, 9)]


def test_an_unfinished_bag_in_the_cache_is_made_anew(small_scenario: Scenario, tmp_path: Path) -> None:
    first = make_bag(small_scenario, {"ann": UID}, tmp_path, workers=1)
    (first / "metadata.yaml").unlink()
    second = make_bag(small_scenario, {"ann": UID}, tmp_path, workers=1)
    assert second == first
    assert BagSource(second).frame_count == 6
    assert [path.name for path in tmp_path.iterdir()] == [first.name]
    assert {path.name for path in first.iterdir()} == {f"{first.name}.mcap", "metadata.yaml"}


def _leave_unfinished(cache: Path, name: str) -> Path:
    place = cache / name
    place.mkdir(parents=True)
    (place / "half.mcap").write_bytes(b"half")
    return place


@pytest.fixture
def dead_pid() -> int:
    """The number of a process that has ended."""
    child = subprocess.Popen([sys.executable, "-c", ""])
    child.wait()
    return child.pid


def test_what_a_killed_maker_left_is_removed_by_the_next_and_nothing_besides(
    small_scenario: Scenario, tmp_path: Path, dead_pid: int
) -> None:
    key = "0123456789abcdef01234567"
    abandoned = _leave_unfinished(tmp_path, f".other-run.1-{key}.{dead_pid}.89abcdef")
    kept = [
        _leave_unfinished(tmp_path, f".other-run-{key}.{os.getpid()}.89abcdef"),
        _leave_unfinished(tmp_path, f"other-run-{key}.{dead_pid}.89abcdef"),
        _leave_unfinished(tmp_path, f".photographs.{dead_pid}.89abcdef"),
        _leave_unfinished(tmp_path, f".other-run-{key}.{dead_pid}.mine"),
    ]
    elsewhere = _leave_unfinished(tmp_path / "elsewhere", "letters")
    link = tmp_path / f".linked-{key}.{dead_pid}.89abcdef"
    link.symlink_to(elsewhere, target_is_directory=True)
    made = make_bag(small_scenario, {"ann": UID}, tmp_path, workers=1)
    assert not abandoned.exists()
    assert {path.name for path in tmp_path.iterdir()} == {*(path.name for path in [*kept, made, link]), "elsewhere"}
    assert all((path / "half.mcap").is_file() for path in [*kept, elsewhere])


def test_several_processes_make_the_same_recording(small_scenario: Scenario, small_bag: Path, tmp_path: Path) -> None:
    other = make_bag(small_scenario, {"ann": UID}, tmp_path, workers=2)
    events = list(BagSource(small_bag).events())
    assert sum(isinstance(event, Frame) for event in events) == small_scenario.frame_count > 0
    for one, two in zip(events, BagSource(other).events(), strict=True):
        if isinstance(one, Frame) and isinstance(two, Frame):
            assert np.array_equal(one.depth, two.depth)
        else:
            assert one == two


def test_a_tag_without_uid_is_refused(small_scenario: Scenario, tmp_path: Path) -> None:
    with pytest.raises(BlockRobotError, match="CONFIGURATION_INVALID"):
        make_bag(small_scenario, {}, tmp_path)


def drain(path: Path) -> int:
    source = BagSource(path)
    source.empty_frames()
    return sum(1 for _ in source.events())


def outcome_of(path: Path) -> str:
    try:
        drain(path)
    except BlockRobotError as error:
        return error.code
    return "read"


def damaged_copy(bag: Path, target: Path, change: object) -> Path:
    copy = target / bag.name
    shutil.copytree(bag, copy)
    (file,) = copy.glob("*.mcap")
    data = bytearray(file.read_bytes())
    file.write_bytes(change(data))  # type: ignore[operator]
    return copy


@pytest.mark.parametrize("share", [0.0, 0.001, 0.3, 0.7])
def test_a_truncated_recording_is_damaged(small_bag: Path, tmp_path: Path, share: float) -> None:
    copy = damaged_copy(small_bag, tmp_path, lambda data: bytes(data[: int(len(data) * share)]))
    with pytest.raises(BlockRobotError, match="BAG_DAMAGED"):
        drain(copy)


@pytest.mark.parametrize("seed", range(40))
def test_flipped_bytes_never_end_in_anything_but_a_code(small_bag: Path, tmp_path: Path, seed: int) -> None:
    rng = random.Random(seed)

    def flip(data: bytearray) -> bytes:
        for _ in range(8):
            data[rng.randrange(len(data))] ^= rng.randrange(1, 256)
        return bytes(data)

    copy = damaged_copy(small_bag, tmp_path, flip)
    assert outcome_of(copy) in {"read", "BAG_DAMAGED", "BAG_TOPIC_MISSING", "TOPICS_INVALID", "EMPTY_SCENE_MISSING"}


@pytest.mark.parametrize("name", ["text.mcap", "text.bag"])
def test_what_is_no_recording_is_damaged(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("this is not a recording")
    with pytest.raises(BlockRobotError, match="BAG_DAMAGED"):
        BagSource(tmp_path / name)


def write_bag(path: Path, topics: dict[str, tuple[str, list[bytes]]]) -> Path:
    codec = MessageCodec()
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic, (kind, messages) in topics.items():
            connection = writer.add_connection(topic, kind, typestore=codec.store)
            for i, data in enumerate(messages):
                writer.write(connection, 1_000_000 * (i + 1), data)
    return path


def test_a_recording_without_sightings_names_the_topic(tmp_path: Path) -> None:
    image = bytes(MessageCodec().encode_image(np.ones((4, 6), np.uint16), 5))
    path = write_bag(tmp_path / "bag", {DEPTH_TOPIC: (IMAGE_TYPE, [image])})
    with pytest.raises(BlockRobotError, match="BAG_TOPIC_MISSING") as refused:
        BagSource(path)
    assert SIGHTING_TOPIC in refused.value.detail


def test_a_topic_of_another_type_is_missing(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "bag", {DEPTH_TOPIC: (IMAGE_TYPE, []), SIGHTING_TOPIC: (IMAGE_TYPE, [])})
    with pytest.raises(BlockRobotError, match="BAG_TOPIC_MISSING"):
        BagSource(path)


def test_a_recording_without_empty_frames_says_so(tmp_path: Path) -> None:
    image = bytes(MessageCodec().encode_image(np.ones((4, 6), np.uint16), 5))
    path = write_bag(tmp_path / "bag", {DEPTH_TOPIC: (IMAGE_TYPE, [image]), SIGHTING_TOPIC: (SIGHTING_TYPE, [])})
    with pytest.raises(BlockRobotError, match="EMPTY_SCENE_MISSING"):
        BagSource(path).empty_frames()

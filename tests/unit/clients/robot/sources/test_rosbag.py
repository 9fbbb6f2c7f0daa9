"""A recording as a source: message types that exist, empty scenes, bad messages in between, topics that come and go."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from clients.robot.cli.reading_warnings import warn_of_silence
from clients.robot.sensing.message_names import DEPTH_TOPIC, EMPTY_TOPIC
from clients.robot.sensing.sensor_events import Facing, Frame, RefusedMessage, Sighting
from clients.robot.sources.messages.topics import Topics, parse_topics
from clients.robot.sources.recordings.bag_source import BagSource, EmptyScene
from consensus.errors import BlockRobotError
from tests.unit.clients.robot.sources.recordings import FORMATS, START_MS, Topic, image, record, stamp

IMAGE = "sensor_msgs/msg/Image"
STRING = "std_msgs/msg/String"
DEPTH = np.full((4, 6), 1500, np.uint16)

TYPES = {
    "stdr_msgs/msg/RfidTag": "string tag_id\nstring message\ngeometry_msgs/Pose2D pose",
    "stdr_msgs/msg/RfidSensorMeasurementMsg": "std_msgs/Header header\nstring[] rfid_tags_ids\n"
    "string[] rfid_tags_msgs\nfloat32[] rfid_tags_dbs",
    "hrl_rfid/msg/RFIDread": "std_msgs/Header header\nstring antenna_name\nstring tagID\nint32 rssi",
    "rfid_reader_ros/msg/Reading": "std_msgs/Header header\nstring ID\nfloat32 txP\nuint64 timestamp\n"
    "float32 rssi\nfloat32 phase\nfloat32 frequency",
    "rfid_reader/msg/RfidTag": "string epc\nuint16 pc\nfloat32 rssi_dbm\nuint8 antenna_id\n"
    "builtin_interfaces/Time first_seen\nbuiltin_interfaces/Time last_seen\nuint32 read_count",
    "rfid_msgs/msg/Tag": "uint8[] uid\nfloat32 distance_cm",
    "rfid_msgs/msg/TagArray": "std_msgs/Header header\nrfid_msgs/Tag[] tags",
}
EPC = "E2000017221101441890"

# type, message, the table of the topics file, what must come out
KNOWN: list[tuple[str, Mapping[str, Any], str, dict[str, Any]]] = [
    (STRING, {"data": EPC}, 'epc = "data"', {}),
    ("stdr_msgs/msg/RfidTag", {"tag_id": EPC}, 'epc = "tag_id"', {}),
    (
        "stdr_msgs/msg/RfidSensorMeasurementMsg",
        {"rfid_tags_ids": [EPC], "rfid_tags_dbs": np.array([-47.5], np.float32)},
        'epc = "rfid_tags_ids[]"\nrssi = "rfid_tags_dbs[]"',
        {"rssi_dbm": -47.5},
    ),
    (
        "hrl_rfid/msg/RFIDread",
        {"antenna_name": "EleLeftEar", "tagID": EPC, "rssi": -61},
        'epc = "tagID"\nrssi = "rssi"\nantenna = "antenna_name"\nfront = ["EleLeftEar"]',
        {"rssi_dbm": -61, "facing": Facing.FRONT},
    ),
    (
        "rfid_reader_ros/msg/Reading",
        {"ID": EPC, "timestamp": START_MS * 1000, "rssi": -50.0},
        'epc = "ID"\nrssi = "rssi"\nfirst_seen = "timestamp"\ntime_unit = "us"',
        {"first_seen_ms": START_MS, "rssi_dbm": -50.0},
    ),
    (
        "rfid_reader/msg/RfidTag",
        {
            "epc": EPC,
            "rssi_dbm": -44.0,
            "antenna_id": 2,
            "first_seen": stamp(START_MS)["stamp"],
            "last_seen": stamp(START_MS + 40)["stamp"],
            "read_count": 3,
        },
        'epc = "epc"\nrssi = "rssi_dbm"\nantenna = "antenna_id"\nback = [2]\nfirst_seen = "first_seen"\n'
        'last_seen = "last_seen"\nread_count = "read_count"',
        {"antenna": 2, "facing": Facing.BACK, "last_seen_ms": START_MS + 40, "read_count": 3},
    ),
    (
        "rfid_msgs/msg/TagArray",
        {"tags": [{"uid": np.frombuffer(bytes.fromhex(EPC), np.uint8), "distance_cm": 210.0}]},
        'epc = "tags[].uid"\ndistance = "tags[].distance_cm"\ndistance_sigma = 40\ndistance_unit = "cm"',
        {"distance_m": pytest.approx(2.1), "sigma_m": pytest.approx(0.4)},
    ),
]


def make(
    folder: Path,
    tags: Sequence[tuple[int, Mapping[str, Any]]] = (),
    *,
    kind: str = "mcap",
    tag_type: str = STRING,
    depth: Sequence[tuple[int, Mapping[str, Any]]] | None = None,
    more: Sequence[Topic] = (),
) -> Path:
    frames = [(i * 100, image(DEPTH, at_ms=START_MS + i * 100)) for i in range(5)] if depth is None else depth
    topics = [Topic(DEPTH_TOPIC, IMAGE, frames), Topic("/tags", tag_type, tags or [(50, {"data": EPC})]), *more]
    return record(folder / "bag", kind, topics, TYPES)


def topics_of(table: str = 'epc = "data"', more: str = "") -> Topics:
    return parse_topics(f"{more}\n[[tags]]\ntopic = '/tags'\n{table}")


@pytest.mark.parametrize("kind", FORMATS)
@pytest.mark.parametrize(("tag_type", "message", "table", "expected"), KNOWN, ids=[row[0] for row in KNOWN])
def test_every_known_type_of_tag_message_is_read(
    tmp_path: Path, kind: str, tag_type: str, message: Mapping[str, Any], table: str, expected: dict[str, Any]
) -> None:
    path = make(tmp_path, [(50, message)], kind=kind, tag_type=tag_type)
    events = list(BagSource(path, topics=topics_of(table)).events())
    assert sum(isinstance(event, Frame) for event in events) == 5
    (sighting,) = [event for event in events if isinstance(event, Sighting)]
    assert sighting.uid == EPC
    assert sighting.received_at_ms == START_MS + 50
    for name, value in expected.items():
        assert getattr(sighting, name) == value


@pytest.mark.parametrize("kind", FORMATS)
def test_metres_in_either_byte_order_become_frames(tmp_path: Path, kind: str) -> None:
    metres = np.where(DEPTH > 0, np.float32(1.5), np.float32(np.nan))
    metres[0, 0] = np.nan
    frames = [(i * 100, image(metres, "32FC1", START_MS + i * 100, big=i % 2 == 1, pad=i)) for i in range(4)]
    found = list(BagSource(make(tmp_path, kind=kind, depth=frames), topics=topics_of()).events())
    depths = [event.depth for event in found if isinstance(event, Frame)]
    assert len(depths) == 4
    for depth in depths:
        assert (depth[0, 0], depth[1, 1]) == (0, 1500)


def bad_frames() -> list[tuple[int, Mapping[str, Any]]]:
    good = [image(DEPTH, at_ms=START_MS + i * 100) for i in range(5)]
    wrong = [{"encoding": "bgr8"}, {"step": 3}, {"data": np.ones(7, np.uint8)}]
    rows = [(i * 100, fields) for i, fields in enumerate(good)]
    rows += [(i * 100 + 50, {**good[i], **change}) for i, change in enumerate(wrong)]
    return rows


def test_bad_frames_are_refused_by_reason_and_the_good_ones_are_numbered_without_them(tmp_path: Path) -> None:
    events = list(BagSource(make(tmp_path, depth=bad_frames()), topics=topics_of()).events())
    assert [event.sequence for event in events if isinstance(event, Frame)] == [0, 1, 2, 3, 4]
    refused = [
        (event.kind, event.reason, event.at_ms - START_MS) for event in events if isinstance(event, RefusedMessage)
    ]
    assert refused == [("frame", "encoding", 50), ("frame", "step", 150), ("frame", "size", 250)]


def test_bad_readings_are_refused_and_the_run_goes_on(tmp_path: Path) -> None:
    path = make(tmp_path, [(10, {"data": ""}), (20, {"data": EPC}), (30, {"data": "x" * 99})])
    events = list(BagSource(path, topics=topics_of()).events())
    assert [event.reason for event in events if isinstance(event, RefusedMessage)] == ["tag", "tag"]
    assert [event.uid for event in events if isinstance(event, Sighting)] == [EPC]


def test_a_frame_without_stamp_has_the_time_of_recording_and_so_has_every_one_if_the_user_says(tmp_path: Path) -> None:
    frames = [(0, image(DEPTH, at_ms=0)), (100, image(DEPTH, at_ms=77_000))]
    path = make(tmp_path, depth=frames)
    by_stamp = [event for event in BagSource(path, topics=topics_of()).events() if isinstance(event, Frame)]
    assert [frame.captured_at_ms for frame in by_stamp] == [START_MS, 77_000]
    by_recording = BagSource(path, topics=topics_of(more="clock = 'recording'")).events()
    assert [event.captured_at_ms - START_MS for event in by_recording if isinstance(event, Frame)] == [0, 100]


def test_a_missing_topic_is_named_with_all_that_is_there_and_what_it_could_be(tmp_path: Path) -> None:
    path = make(tmp_path, more=[Topic("/odom", "geometry_msgs/msg/Pose2D", [(1, {})])])
    with pytest.raises(BlockRobotError) as refused:
        BagSource(path, topics=parse_topics("[depth]\ntopic = '/kinect'\n[[tags]]\ntopic = '/tags'\nepc = 'data'"))
    assert refused.value.code == "BAG_TOPIC_MISSING"
    for part in (
        "/kinect",
        f"{DEPTH_TOPIC} (sensor_msgs/msg/Image, 16UC1, 5 messages, could be depth)",
        "/tags",
        "/odom",
    ):
        assert part in refused.value.detail
    assert EPC not in refused.value.detail


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("[depth]\ntopic = '/tags'\n[[tags]]\ntopic = '/odom'\nepc = 'x'", "BAG_TOPIC_MISSING"),
        ("[[tags]]\ntopic = '/tags'\ntype = 'a/msg/B'\nepc = 'data'", "BAG_TOPIC_MISSING"),
    ],
)
def test_a_topic_of_another_type_is_refused_before_anything_is_read(tmp_path: Path, text: str, code: str) -> None:
    path = make(tmp_path, more=[Topic("/odom", "geometry_msgs/msg/Pose2D", [(1, {})])])
    with pytest.raises(BlockRobotError, match=code):
        BagSource(path, topics=parse_topics(text))


@pytest.mark.parametrize(
    ("table", "named"),
    [
        ('epc = "epc"\nantenna = "antena"', 'tags[0].antenna = "antena" is no field of rfid_reader/msg/RfidTag'),
        ('epc = "epc"\nrssi = "rssi"', 'tags[0].rssi = "rssi"'),
        ('epc = "epc"\nfacing = "forward"', 'it is neither "front" nor "back"'),
        ('epc = "epc[]"', "tags[0].epc"),
        ('epc = "epc"\nfirst_seen = "first_seen.sec.x"', "tags[0].first_seen"),
        ('epc = "data{}.epc"', "tags[0].epc"),
    ],
)
def test_a_field_that_the_type_has_not_is_refused_at_the_start_with_those_it_has(
    tmp_path: Path, table: str, named: str
) -> None:
    path = make(tmp_path, [(50, KNOWN[5][1])], tag_type="rfid_reader/msg/RfidTag")
    with pytest.raises(BlockRobotError, match="TOPICS_INVALID") as refused:
        BagSource(path, topics=topics_of(table))
    assert named in refused.value.detail
    assert "epc, pc, rssi_dbm, antenna_id" in refused.value.detail


@pytest.mark.parametrize("table", ["[labels]\ntopic = '/odom'\ntext = 'word'", "[audio]\ntopic = '/odom'"])
def test_a_field_of_another_sense_that_the_type_has_not_is_refused_too(tmp_path: Path, table: str) -> None:
    path = make(tmp_path, more=[Topic("/odom", "geometry_msgs/msg/Pose2D", [(1, {})])])
    with pytest.raises(BlockRobotError, match="TOPICS_INVALID") as refused:
        BagSource(path, topics=topics_of(more=table))
    assert "It has x, y, theta." in refused.value.detail


def test_what_only_messages_tell_is_refused_with_its_reason_in_a_sentence(tmp_path: Path) -> None:
    path = make(tmp_path, [(50, {"data": '{"id": "A"}'})])
    (refused,) = [
        e for e in BagSource(path, topics=topics_of('epc = "data{}.uid"')).events() if isinstance(e, RefusedMessage)
    ]
    assert (refused.reason, refused.detail) == ("field", "The message has no field data{}.uid.")


def test_antennas_that_the_file_does_not_name_are_counted_where_it_names_others(tmp_path: Path) -> None:
    path = make(tmp_path, [(50, KNOWN[5][1])] * 3, tag_type="rfid_reader/msg/RfidTag")
    for front, expected in (("[1]", {"/tags": {"2": 3}}), ("[2]", {})):
        source = BagSource(path, topics=topics_of(f'epc = "epc"\nantenna = "antenna_id"\nfront = {front}'))
        list(source.events())
        assert source.antennas_unnamed == expected


def test_empty_scenes_come_from_a_topic_a_stretch_or_another_recording(tmp_path: Path) -> None:
    empty = [Topic(EMPTY_TOPIC, IMAGE, [(0, image(DEPTH + 1)), (1, image(DEPTH[:2])), (2, image(DEPTH, "rgb8"))])]
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    with_topic = make(tmp_path / "a", more=empty)
    without = make(tmp_path / "b")
    assert [depth[0, 0] for depth in BagSource(with_topic, topics=topics_of()).empty_frames()] == [1501]
    stretch = BagSource(without, topics=topics_of(), empty=EmptyScene(seconds=(0.1, 0.3)))
    assert len(stretch.empty_frames()) == 3
    elsewhere = BagSource(without, topics=topics_of(), empty=EmptyScene(recording=with_topic))
    assert [depth[0, 0] for depth in elsewhere.empty_frames()] == [1501]
    other_depth = BagSource(with_topic, topics=topics_of(), empty=EmptyScene(recording=without))
    assert len(other_depth.empty_frames()) == 5


@pytest.mark.parametrize(
    ("limit", "most", "expected"),
    [
        ("EMPTY_FRAMES_MAX_COUNT", 4, [0, 4, 8]),
        ("EMPTY_FRAMES_MAX_BYTES", 3 * DEPTH.nbytes, [0, 4, 8]),
        ("EMPTY_FRAMES_MAX_BYTES", 1, [0]),
        ("EMPTY_FRAMES_READ_MAX_COUNT", 3, [0, 1, 2]),
    ],
)
def test_empty_frames_are_bounded_in_number_and_bytes_and_spread_over_the_stretch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limit: str, most: int, expected: list[int]
) -> None:
    monkeypatch.setattr(f"clients.robot.sources.source.{limit}", most)
    path = make(tmp_path, more=[Topic(EMPTY_TOPIC, IMAGE, [(i, image(DEPTH + i)) for i in range(10)])])
    assert [int(depth[0, 0]) - 1500 for depth in BagSource(path, topics=topics_of()).empty_frames()] == expected


def test_a_recording_of_nothing_has_no_start(tmp_path: Path) -> None:
    path = record(tmp_path / "bag", "mcap", [Topic(DEPTH_TOPIC, IMAGE, []), Topic("/tags", STRING, [])])
    with pytest.raises(BlockRobotError, match="BAG_DAMAGED"):
        _ = BagSource(path, topics=topics_of()).start_ms


def test_a_recording_without_a_depth_image_says_so_and_names_silent_topics_of_tags(tmp_path: Path) -> None:
    path = record(tmp_path / "bag", "mcap", [Topic(DEPTH_TOPIC, IMAGE, []), Topic("/tags", STRING, [])])
    source = BagSource(path, topics=topics_of(), empty=EmptyScene(seconds=(0, 3)))
    with pytest.raises(BlockRobotError, match=f"^BAG_TOPIC_MISSING: .*no depth image: 0 messages of {DEPTH_TOPIC}"):
        source.empty_frames()
    assert source.silent_tag_topics == ["/tags"]
    assert list(warn_of_silence(source.silent_tag_topics)) == [
        "No reading of a tag comes from /tags: the recording holds 0 messages of it."
    ]


def test_without_an_empty_scene_the_refusal_says_how_to_choose_one(tmp_path: Path) -> None:
    source = BagSource(make(tmp_path), topics=topics_of())
    with pytest.raises(BlockRobotError, match="EMPTY_SCENE_MISSING") as refused:
        source.empty_frames()
    assert "--empty-seconds" in refused.value.next_step


def test_equal_stamps_a_step_back_and_topics_that_vanish_and_return_all_come_through(tmp_path: Path) -> None:
    times = [0, 100, 100, 50, 200, 20_000, 20_100]  # by the camera's stamp; then twenty seconds without a frame
    frames = [(i * 100 if i < 5 else at, image(DEPTH, at_ms=START_MS + at)) for i, at in enumerate(times)]
    tags = [(at, {"data": EPC}) for at in (10, 5_000, 9_000, 60_000, 60_100)]
    events = list(BagSource(make(tmp_path, tags, depth=frames), topics=topics_of()).events())
    assert [event.captured_at_ms - START_MS for event in events if isinstance(event, Frame)] == times
    assert [event.last_seen_ms - START_MS for event in events if isinstance(event, Sighting)] == [
        10,
        5_000,
        9_000,
        60_000,
        60_100,
    ]


def test_a_topic_that_never_speaks_is_no_fault(tmp_path: Path) -> None:
    path = record(
        tmp_path / "bag", "mcap", [Topic(DEPTH_TOPIC, IMAGE, []), Topic("/tags", STRING, [(9, {"data": EPC})])]
    )
    source = BagSource(path, topics=topics_of())
    assert source.start_ms == START_MS + 9
    assert [type(event) for event in source.events()] == [Sighting]

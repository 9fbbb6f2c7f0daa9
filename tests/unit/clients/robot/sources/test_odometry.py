"""Where the robot is, out of messages of ROS 1 and 2: odometry, transforms, and what is refused."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore

from clients.robot.hiding.own_motion import RobotPlace
from clients.robot.sensing.sensor_clocks import RunClocks
from clients.robot.sensing.sensor_events import Frame, Odometry, RefusedMessage, SourceEvent
from clients.robot.sources.messages.topics import OdometryTopic, Topics, parse_topics
from clients.robot.sources.recordings.bag_source import BagSource
from clients.robot.sources.recordings.recording import Recording
from clients.robot.sources.recordings.topic_listing import draft_topics, list_topics
from consensus.errors import BlockRobotError

STORE = get_typestore(Stores.ROS2_HUMBLE)
TYPES: Any = STORE.types
ODOMETRY, TRANSFORMS = "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"
DEPTH = "/camera/depth"
START_S = 1_700_000_000


def header(at_ms: int, frame: str) -> Any:
    stamp = TYPES["builtin_interfaces/msg/Time"](START_S + at_ms // 1000, at_ms % 1000 * 1_000_000)
    return TYPES["std_msgs/msg/Header"](stamp, frame)


def turned(yaw: float) -> Any:
    return TYPES["geometry_msgs/msg/Quaternion"](0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))


def odometry(at_ms: int, x: float, y: float, yaw: float, *, frame: str = "odom") -> Any:
    pose = TYPES["geometry_msgs/msg/Pose"](TYPES["geometry_msgs/msg/Point"](x, y, 0.0), turned(yaw))
    zero = TYPES["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    speeds = TYPES["geometry_msgs/msg/TwistWithCovariance"](TYPES["geometry_msgs/msg/Twist"](zero, zero), np.zeros(36))
    placed = TYPES["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36))
    return TYPES[ODOMETRY](header(at_ms, frame), "base_link", placed, speeds)


def transforms(at_ms: int, *places: tuple[str, str, float, float, float]) -> Any:
    made = [
        TYPES["geometry_msgs/msg/TransformStamped"](
            header(at_ms, parent),
            child,
            TYPES["geometry_msgs/msg/Transform"](TYPES["geometry_msgs/msg/Vector3"](x, y, 0.0), turned(yaw)),
        )
        for parent, child, x, y, yaw in places
    ]
    return TYPES[TRANSFORMS](made)


def write_bag(path: Path, *messages: tuple[str, str, Any]) -> Path:
    """Write messages 100 ms apart, and a frame."""
    depth = TYPES["sensor_msgs/msg/Image"](header(0, "camera"), 2, 2, "16UC1", 0, 4, np.full(8, 9, np.uint8))
    with Writer(path, version=9) as writer:
        known = {}
        for place, (topic, kind, message) in enumerate([(DEPTH, "sensor_msgs/msg/Image", depth), *messages]):
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=STORE)
            data = STORE.serialize_cdr(message, kind)
            writer.write(known[topic], START_S * 1_000_000_000 + place * 100_000_000, data)
    return path


def read(path: Path, **odometry_options: Any) -> list[SourceEvent]:
    topics = Topics(depth=DEPTH, tags=(), odometry=OdometryTopic(**odometry_options))
    return [event for event in BagSource(path, topics=topics).events() if not isinstance(event, Frame)]


def test_odometry_is_read_with_its_own_stamp_and_when_it_came(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", ("/odom", ODOMETRY, odometry(40, 1.5, -0.5, 0.3)))
    (place,) = read(bag, topic="/odom")
    assert isinstance(place, Odometry)
    assert (place.at_ms, place.received_at_ms) == (START_S * 1000 + 40, START_S * 1000 + 100)
    assert (place.ahead_m, place.left_m, place.yaw) == pytest.approx((1.5, -0.5, 0.3))


def test_of_transforms_only_those_between_the_named_frames_count(tmp_path: Path) -> None:
    both = transforms(40, ("map", "odom", 9.0, 9.0, 1.0), ("odom", "base_link", 2.0, 1.0, -0.4))
    bag = write_bag(tmp_path / "bag", ("/tf", TRANSFORMS, both), ("/tf", TRANSFORMS, transforms(50)))
    (place,) = read(bag, topic="/tf", parent="/odom", child="base_link")
    assert isinstance(place, Odometry)
    assert (place.ahead_m, place.left_m, place.yaw) == pytest.approx((2.0, 1.0, -0.4))


def test_a_message_of_more_transforms_than_any_robot_has_is_refused_before_it_is_decoded(tmp_path: Path) -> None:
    crowd = transforms(40, *[("map", f"bed_{number:04d}", 0.0, 0.0, 0.0) for number in range(4_000)])
    few = transforms(50, *[("odom", "base_link", 2.0, 1.0, -0.4)] * 1_000)
    bag = write_bag(tmp_path / "bag", ("/tf", TRANSFORMS, crowd), ("/tf", TRANSFORMS, few))
    refused, *places = read(bag, topic="/tf", parent="odom", child="base_link")
    assert isinstance(refused, RefusedMessage)
    assert (refused.kind, refused.reason) == ("odometry", "size")
    assert len(places) == 1_000


def test_another_frame_is_refused_and_counted(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", ("/odom", ODOMETRY, odometry(40, 0.0, 0.0, 0.0, frame="map")))
    (refused,) = read(bag, topic="/odom", parent="odom")
    assert isinstance(refused, RefusedMessage)
    assert (refused.kind, refused.reason) == ("odometry", "frame")
    assert "map -> base_link" in refused.detail


@pytest.mark.parametrize("x", [math.nan, math.inf, 1e9])
def test_a_place_that_is_no_place_is_refused(tmp_path: Path, x: float) -> None:
    bag = write_bag(tmp_path / "bag", ("/odom", ODOMETRY, odometry(40, x, 0.0, 0.0)))
    (refused,) = read(bag, topic="/odom")
    assert isinstance(refused, RefusedMessage)
    assert refused.reason == "field"


def test_a_rotation_of_zero_is_refused(tmp_path: Path) -> None:
    message = odometry(40, 1.0, 0.0, 0.0)
    message.pose.pose.orientation.w = 0.0
    bag = write_bag(tmp_path / "bag", ("/odom", ODOMETRY, message))
    assert [type(event) for event in read(bag, topic="/odom")] == [RefusedMessage]


def test_a_topic_of_another_type_is_named(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", ("/odom", "std_msgs/msg/String", TYPES["std_msgs/msg/String"]("x")))
    with pytest.raises(BlockRobotError, match="which is no odometry") as refused:
        read(bag, topic="/odom")
    assert refused.value.code == "BAG_TOPIC_MISSING"


def test_transforms_need_the_names_of_two_frames(tmp_path: Path) -> None:
    bag = write_bag(tmp_path / "bag", ("/tf", TRANSFORMS, transforms(40)))
    with pytest.raises(BlockRobotError, match="name parent and child"):
        read(bag, topic="/tf", parent="odom")


def test_odometry_is_found_and_drafted_before_transforms(tmp_path: Path) -> None:
    tf = ("/tf", TRANSFORMS, transforms(40, ("odom", "base_footprint", 0.0, 0.0, 0.0)))
    with_both = write_bag(tmp_path / "both", tf, ("/odom", ODOMETRY, odometry(40, 0.0, 0.0, 0.0)))
    drafted = parse_topics(draft_of(with_both))
    assert drafted.odometry == OdometryTopic("/odom")
    drafted = parse_topics(draft_of(write_bag(tmp_path / "one", tf)))
    assert drafted.odometry == OdometryTopic("/tf", "odom", "base_footprint")
    beds = [("/tf", TRANSFORMS, transforms(at_ms, ("map", "bed", 0.0, 0.0, 0.0))) for at_ms in range(8)]
    assert parse_topics(draft_of(write_bag(tmp_path / "late", *beds, tf))).odometry == drafted.odometry
    without = write_bag(tmp_path / "none", ("/tf", TRANSFORMS, transforms(40, ("map", "bed", 0.0, 0.0, 0.0))))
    assert parse_topics(draft_of(without)).odometry is None


def test_a_strangers_name_stays_a_name_in_a_draft(tmp_path: Path) -> None:
    frame = 'odom"\n[[llrp]]\nhost = "10.0.0.9"\n#\u202e'
    bag = write_bag(tmp_path / "bag", ("/tf", TRANSFORMS, transforms(40, (frame, "base", 0.0, 0.0, 0.0))))
    drafted = parse_topics(draft_of(bag))
    assert drafted.odometry == OdometryTopic("/tf", frame, "base")
    assert drafted.llrp == ()
    assert all(line.isprintable() for line in draft_of(bag).splitlines())


def draft_of(path: Path) -> str:
    recording = Recording(path, {})
    return draft_topics(recording, list_topics(recording))


def test_where_the_camera_is_may_be_said(tmp_path: Path) -> None:
    text = '[odometry]\ntopic = "/odom"\ncamera_ahead_m = 0.2\ncamera_left_m = -0.1\n'
    made = parse_topics(text).odometry
    assert made == OdometryTopic("/odom", camera_ahead_m=0.2, camera_left_m=-0.1)
    place = RobotPlace.of_camera(Odometry(0, 1.0, 2.0, math.pi / 2), 0.2, -0.1)
    assert (place.x_m, place.z_m, place.yaw) == pytest.approx((-2.2, 1.1, -math.pi / 2))
    with pytest.raises(BlockRobotError, match="camera_ahead_m"):
        parse_topics('[odometry]\ntopic = "/odom"\ncamera_ahead_m = 50\n')


def test_odometry_of_another_clock_is_moved_onto_the_cameras() -> None:
    clocks, found = RunClocks(), []
    for step in range(100):
        received = 1_000_000 + step * 100
        clocks.admit(Frame(received - 20, step, np.zeros((1, 1), np.uint16), received))
        found += clocks.admit(Odometry(received - 3_000_000 - 20, 0.0, 0.0, 0.0, received))
    last = found[-1]
    assert isinstance(last, Odometry)
    assert abs(last.at_ms - (1_009_900 - 20)) <= 5
    assert set(clocks.estimates()) == {"camera", "odometry"}

"""A drive as a recording: frames, readings and odometry by topic, and empty frames from where the robot starts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clients.robot.sensing.message_names import ODOMETRY_TOPIC
from clients.robot.sensing.sensor_events import Frame, Odometry, Sighting, SourceEvent
from clients.robot.sources.messages.topics import OdometryTopic, Topics
from clients.robot.sources.recordings.bag_source import BagSource
from clients.robot.synthetic.driving.draws import draw_drive
from clients.robot.synthetic.driving.drive import Drive
from clients.robot.synthetic.scenario_bag import RUN_START_MS, make_bag


@pytest.fixture(scope="module")
def drive() -> Drive:
    made = draw_drive(1, "straight", judging=False, stands_s=1.0)
    return replace(made, scenario=replace(made.scenario, duration_s=2.0, empty_frames=2))


@pytest.fixture(scope="module")
def source(drive: Drive, tmp_path_factory: pytest.TempPathFactory) -> BagSource:
    uids = {alias: f"E2{number:022d}" for number, alias in enumerate(drive.scenario.tagged_aliases)}
    bag = make_bag(drive, uids, tmp_path_factory.mktemp("bags"), workers=1)
    return BagSource(bag, topics=replace(Topics(), odometry=OdometryTopic(ODOMETRY_TOPIC)))


def only(source: BagSource, kind: type[SourceEvent]) -> list[SourceEvent]:
    return [event for event in source.events() if isinstance(event, kind)]


def test_all_three_kinds_come_in_the_order_in_which_they_arrive(source: BagSource) -> None:
    events = list(source.events())
    assert len(only(source, Frame)) == 10
    assert only(source, Sighting)
    came = [event.received_at_ms for event in events if isinstance(event, Frame | Sighting | Odometry)]
    assert came == sorted(came)


def test_odometry_is_what_the_drive_says(drive: Drive, source: BagSource) -> None:
    places = [event for event in only(source, Odometry) if isinstance(event, Odometry)]
    said = drive.odometry()
    assert len(places) == len(said)
    for place, sample in zip(places, said, strict=True):
        assert place.at_ms == RUN_START_MS + round(1000 * sample.at_s)
        assert (place.ahead_m, place.left_m, place.yaw) == pytest.approx((sample.z_m, -sample.x_m, -sample.yaw))


def test_empty_frames_show_the_room_from_where_the_robot_starts_and_nobody_in_it(source: BagSource) -> None:
    empty = source.empty_frames()
    first = next(event.depth for event in source.events() if isinstance(event, Frame))
    assert len(empty) == 2
    assert not np.array_equal(empty[0], empty[1])
    nearer = np.count_nonzero((first > 0) & (first < 0.9 * empty[0]))
    farther = np.count_nonzero((empty[0] > 0) & (empty[0] < 0.9 * first))
    assert nearer > 10 * farther + 300

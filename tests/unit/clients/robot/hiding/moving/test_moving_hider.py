"""The hider of a robot that drives, in a drawn room: what it does while the odometry lies about the way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from clients.robot.hiding.companion import Trees
from clients.robot.hiding.cutouts import EncodedCutout
from clients.robot.hiding.hider import FoundPeople
from clients.robot.hiding.moving.ground_plane import Ground
from clients.robot.hiding.moving.moving_hider import Models, MovingHider
from clients.robot.hiding.moving.plan_bodies import ASIDE_M, PlanView
from clients.robot.hiding.moving.release_rule import LOG_ODDS_LIMIT
from clients.robot.hiding.own_motion import OwnMotion, RobotPlace
from clients.robot.hiding.segmentation import Silhouette
from clients.robot.sensing.sensor_events import Depth
from clients.robot.synthetic.driving.draws import draw_drive
from clients.robot.synthetic.driving.drive_render import DriveRenderer
from clients.robot.synthetic.scenario_bag import drive_odometry
from tests.unit.clients.robot.hiding.moving.boards import EYE_M, FOCAL_PX, PERSON_M, SLIVER, STRAYS_M, draw

BUFFER_MS, ENDS_MS = 2_000, 7_000


@pytest.mark.parametrize("share_said", [1.0, 0.0, 2.0])
def test_a_frame_is_given_up_when_the_room_moves_otherwise_than_said(share_said: float) -> None:
    drive = draw_drive(70_000, "straight", judging=False, stands_s=1.0)
    scenario, renderer, motion = drive.scenario, DriveRenderer(drive), OwnMotion()
    mount = Ground.of_mount(drive.mount.believed_height_m, drive.mount.believed_pitch)
    shape = (scenario.height, scenario.width)
    hider = MovingHider(shape, scenario.focal_px, mount, buffer_ms=BUFFER_MS, motion=motion)
    for _, odometry in drive_odometry(drive, 0):
        place = RobotPlace.of_camera(odometry, 0.0, 0.0)
        motion.add(replace(place, x_m=place.x_m * share_said, z_m=place.z_m * share_said))
    given_up, asked = [], {}
    for index in range(int(ENDS_MS / 1000 * scenario.frame_rate)):
        at_ms = round(index * 1000 / scenario.frame_rate)
        found = hider.find_people(renderer.truth(index).depth, motion.place_at(at_ms), at_ms)
        if found is None:
            given_up.append(at_ms)
        else:
            asked[at_ms] = list(found.may_show.values())
    assert bool(given_up) == (share_said != 1.0)
    for at_ms in given_up:
        assert motion.is_doubted(at_ms, at_ms)
        assert motion.stands(at_ms) is not True
        assert not any(may_show() for may_show in asked.get(at_ms - 200, []))
    assert not motion.is_doubted(0, 1_000 - 500), "while it stood, nothing was wrong"


def test_what_lies_on_the_edge_of_the_plan_is_looked_at_like_all_else() -> None:
    edge = np.nextafter(np.float32(ASIDE_M), np.float32(0))
    about = np.float32(ASIDE_M) / np.float32(6)
    rays = [about]
    for _ in range(8):
        rays += [np.nextafter(rays[-1], np.float32(0))]
    ray = next(ray for ray in rays if np.float32(6) * ray == edge)
    middle = (640 - 1) / 2
    view = PlanView((480, 640), float((636 - middle) / ray), Ground.of_mount(1.2, 0.0))
    depth = np.zeros((480, 640), np.uint16)
    depth[240, 636] = 6_000
    assert view.look(depth).x[60, 159] == edge


def always(log_odds: float) -> Trees:
    one = np.zeros(1, dtype=np.int64)
    return Trees(one, one, np.zeros(1), one, one, np.array([log_odds]), 0.0, 0, 0.0, 0.0)


def head_behind(low_m: float, high_m: float) -> Depth:
    left_right, _, ahead_m = SLIVER
    return draw(PERSON_M, (left_right, (low_m, high_m), ahead_m), strays_m=STRAYS_M)


def sure_hider(sides: tuple[int, int] | None = None) -> MovingHider:
    """It is sure of each body that it is one person, whatever the body."""
    models = Models(person=always(3.0), pair=always(-3.0), thing=always(-3.0))
    mount = Ground.of_mount(EYE_M, 0.0)
    motion = OwnMotion()
    return MovingHider((480, 640), FOCAL_PX, mount, buffer_ms=BUFFER_MS, motion=motion, models=models, sides=sides)


@pytest.fixture
def hider() -> MovingHider:
    return sure_hider()


@pytest.mark.parametrize(("low_m", "high_m", "two"), [(1.4, 1.7, True), (0.4, 0.9, False)])
def test_a_head_behind_a_person_speaks_for_two_whatever_the_models_say(
    hider: MovingHider, low_m: float, high_m: float, two: bool
) -> None:
    (seen,) = hider.look(head_behind(low_m, high_m), RobotPlace(0), 0)[1]
    assert seen.sighted.alone == (-LOG_ODDS_LIMIT if two else 3.0)


def test_of_whom_another_way_found_those_who_look_like_two_here_are_not_shown(hider: MovingHider) -> None:
    def found_by_another_way(at_ms: int, depth: Depth) -> FoundPeople:
        person, elsewhere = (
            Silhouette(label, (0, 0, 1, 1), right_m, 2.0, 2.0, 2_000, "", ahead_m=2.0, right_m=right_m)
            for label, right_m in ((7, 0.0), (8, 2.0))
        )
        found = FoundPeople((person, elsewhere), False, lambda one: EncodedCutout(one.label, 0, 1, 1, b""))
        return hider.look_again(found, depth, RobotPlace(at_ms), at_ms)

    before = found_by_another_way(0, draw(PERSON_M)).may_show
    assert before[8].why_not() == "unverified", "there is no body here, or it is part of something large"
    assert before[7]()
    two = found_by_another_way(200, head_behind(1.4, 1.7)).may_show
    assert two[7].why_not() == "merged"
    assert not before[7](), "somebody who was seen behind them just after may have been there"
    long_after = found_by_another_way(200 + 2 * BUFFER_MS, draw(PERSON_M)).may_show
    assert long_after[7]()
    hider.restart()
    assert long_after[7](), "what was seen before is not forgotten by who asks"


@pytest.mark.parametrize("on_the_right", [False, True])
@pytest.mark.parametrize("unmeasured_px", [0, 4, 20])
def test_the_picture_ends_where_the_camera_measures_nothing(*, on_the_right: bool, unmeasured_px: int) -> None:
    """Stereo and registered depth leave out some columns at the sides."""
    sides = (unmeasured_px, 639 - unmeasured_px)
    for nearest_m, obstacle in ((1.0, "cut-off"), (0.5, "")):
        place = (nearest_m, nearest_m + 0.5) if on_the_right else (-nearest_m - 0.5, -nearest_m)
        depth = draw((place, (0.3, 1.7), 2.0))
        depth[:, : sides[0]] = 0
        depth[:, sides[1] + 1 :] = 0
        hider = sure_hider(sides if unmeasured_px else None)
        (seen,) = hider.look(depth, RobotPlace(0), 0)[1]
        assert seen.obstacle == obstacle

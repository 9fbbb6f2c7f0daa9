"""What was made fast gives, bit for bit, what the simple way gives."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import resources

import msgspec
import numpy as np
import numpy.typing as npt
import pytest

from clients.robot.hiding.companion import Table, trees_of
from clients.robot.hiding.moving.blank_cutouts import FEET_M, MARGIN_PX, _joined, cut_body
from clients.robot.hiding.moving.body_cues import BODY_CUES, Body
from clients.robot.hiding.moving.ground_plane import Ground
from clients.robot.hiding.moving.moving_hider import MODEL_FILES, MovingHider, shipped_models
from clients.robot.hiding.moving.plan_bodies import (
    AHEAD_M,
    ASIDE_M,
    CELL_M,
    HIGHEST_M,
    NOISE_SIGMAS,
    STEP_PX,
    LevelView,
)
from clients.robot.hiding.moving.wall_lines import BIN_M, NEAR_M, Wall
from clients.robot.hiding.own_motion import OwnMotion, RobotPlace
from clients.robot.sensing.depth_noise import depth_sigma_m
from clients.robot.sensing.sensor_events import Depth
from clients.robot.synthetic.driving.draws import DriveStratum, draw_drive
from clients.robot.synthetic.driving.drive_render import DriveRenderer

Floats = npt.NDArray[np.float32]

MODELS = resources.files("clients.robot.hiding.moving")


def covers(wall: Wall, x: Floats, z: Floats, noise_m: Floats) -> npt.NDArray[np.bool_]:
    behind = wall.depth_behind(x, z)
    robot = float(wall.depth_behind(np.zeros(1, np.float32), np.zeros(1, np.float32))[0])
    share = np.clip(robot / np.minimum(robot - behind, -1e-6), 0.0, 1.0).astype(np.float32)
    met = np.where(behind > 0, share, np.float32(1))
    along = (met * x - wall.x_m) * wall.along_x + (met * z - wall.z_m) * wall.along_z
    reaches = (along > wall.begin_m - BIN_M) & (along < wall.end_m + BIN_M)
    return np.asarray((behind > -(NEAR_M + noise_m)) & reaches)


def cut(depth: Depth, view: LevelView, body: Body, focal_px: float) -> Depth:
    """Return the body's pixels in its box, which are looked for among all pixels of the box."""
    left, top, width, height = (STEP_PX * part for part in body.box)
    x0, y0 = max(0, left - MARGIN_PX), max(0, top - MARGIN_PX)
    x1, y1 = min(depth.shape[1], left + width + MARGIN_PX), min(depth.shape[0], top + height + MARGIN_PX)
    pixels = depth[y0:y1, x0:x1]
    ahead = pixels.astype(np.float32) / np.float32(1000)
    across = ((np.arange(x0, x1) - (depth.shape[1] - 1) / 2) / focal_px).astype(np.float32)[None, :]
    down = ((np.arange(y0, y1) - (depth.shape[0] - 1) / 2) / focal_px).astype(np.float32)[:, None]
    axes = view.ground.level_axes().astype(np.float32)
    x, up, z = (ahead * (across * axis[0] + (down * axis[1] + axis[2])) for axis in axes)
    up += np.float32(view.ground.height_m)
    own = (ahead > 0) & (up > FEET_M) & (up < HIGHEST_M) & (z > 0) & (z < AHEAD_M) & (np.abs(x) < ASIDE_M)
    column = ((x[own] + np.float32(ASIDE_M)) / np.float32(CELL_M)).astype(np.int64)
    row = (z[own] / np.float32(CELL_M)).astype(np.int64)
    own[own] = view.cells[row, column] == body.label
    for wall in view.walls:
        own &= ~covers(wall, x, z, NOISE_SIGMAS * depth_sigma_m(ahead))
    own &= pixels <= body.behind_mm(view)
    return np.where(_joined(own.view(np.uint8), body, x0, y0), pixels, np.uint16(0))


def looked_at(stratum: DriveStratum) -> Iterator[tuple[Depth, LevelView, list[Body], float]]:
    drive = draw_drive(70_000, stratum, judging=False)
    scenario, renderer = drive.scenario, DriveRenderer(drive)
    mount = Ground.of_mount(drive.mount.believed_height_m, drive.mount.believed_pitch)
    shape = (scenario.height, scenario.width)
    hider = MovingHider(shape, scenario.focal_px, mount, buffer_ms=2_000, motion=OwnMotion())
    for index in range(0, scenario.frame_count, 6):
        depth, at_ms = renderer.truth(index).depth, round(index * 1000 / scenario.frame_rate)
        view, seen = hider.look(depth, RobotPlace(at_ms), at_ms)
        yield depth, view, [one.body for one in seen], scenario.focal_px


@pytest.mark.parametrize("stratum", ["companions", "crowd", "ramp", "past"])
def test_a_body_is_cut_out_as_by_looking_at_each_pixel_of_its_box(stratum: DriveStratum) -> None:
    bodies_count = 0
    for depth, view, bodies, focal_px in looked_at(stratum):
        for body in bodies:
            assert np.array_equal(cut_body(depth, view, body, focal_px).pixels, cut(depth, view, body, focal_px))
            bodies_count += 1
    assert bodies_count >= 8


def test_a_wall_covers_what_it_covers_by_all_its_conditions_together() -> None:
    rng = np.random.default_rng(1)
    covered_count = 0
    for _ in range(200):
        x, z = rng.uniform(-5, 5, 300).astype(np.float32), rng.uniform(0, 7.9, 300).astype(np.float32)
        angle, (begin, end) = rng.uniform(0, 2 * np.pi), sorted(rng.uniform(-3, 3, 2))
        wall = Wall(*rng.uniform(-3, 6, 2), float(np.cos(angle)), float(np.sin(angle)), begin, end)
        noise_m = rng.uniform(0, 0.1, 300).astype(np.float32)
        found = wall.covers(x, z, noise_m)
        assert np.array_equal(found, covers(wall, x, z, noise_m))
        covered_count += np.count_nonzero(found)
    assert 5_000 < covered_count < 30_000
    assert Wall(0.0, 3.0, 1.0, 0.0, -1.0, 1.0).covers(x[:0], z[:0], x[:0]).size == 0


def leaf(table: Table, tree: int, cues: npt.NDArray[np.float64]) -> float:
    node = 0
    for _ in range(table.depth):
        below = cues[table.feature[tree][node]] <= table.threshold[tree][node]
        node = (table.left if below else table.right)[tree][node]
    return table.value[tree][node]


def test_trees_say_what_each_of_them_says_alone() -> None:
    rng = np.random.default_rng(2)
    for name, file in MODEL_FILES.items():
        table = msgspec.json.decode((MODELS / file).read_bytes(), type=Table, strict=False)
        cues = rng.normal(0.5, 1.0, (20, len(BODY_CUES)))
        for row in cues:
            told = table.first + sum(leaf(table, tree, row) for tree in range(len(table.feature)))
            assert getattr(shipped_models(), name).log_odds(row) == pytest.approx(told, abs=1e-9)
        assert len({trees_of(table, BODY_CUES).log_odds(row) for row in cues}) > 10

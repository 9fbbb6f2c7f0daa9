"""Bodies that a driving robot sees, each with the truth about it: what the models of the moving hider learn from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from clients.robot.hiding.companion import Floats
from clients.robot.hiding.flying_pixels import drop_flying_pixels
from clients.robot.hiding.moving.body_cues import Body, measure_bodies
from clients.robot.hiding.moving.ground_plane import Ground
from clients.robot.hiding.moving.plan_bodies import STEP_PX, LevelView, PlanView
from clients.robot.sensing.sensor_events import Depth
from clients.robot.synthetic.driving.drive import Drive
from clients.robot.synthetic.driving.drive_render import DriveRenderer, DriveTruth

ALONE_MAX_SHARE = 0.002  # of a body's pixels: fewer of anybody else is noise at an edge
SECOND_MIN_SHARE = 0.02
PERSON_MIN_SHARE = 0.97
WHOLE_MIN_SHARE = 0.85  # of what is in the picture of a person
THING_MAX_SHARE = 0.01

Kind = Literal["person", "people", "part", "thing", "unclear"]


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """A body's cues, and shares of its pixels: of whom it shows most, and of whom next; `whole`: how much of the former's
    visible pixels it holds.
    """

    first: float
    second: float
    whole: float
    cues: Floats

    @property
    def kind(self) -> Kind:
        """One person and nothing else, two or more, a part of one or one with something, no person, or neither."""
        if self.second >= SECOND_MIN_SHARE:
            return "people"
        if self.first <= THING_MAX_SHARE:
            return "thing"
        if self.second > ALONE_MAX_SHARE or 0.9 < self.first < PERSON_MIN_SHARE:
            return "unclear"
        return "person" if self.first >= PERSON_MIN_SHARE and self.whole >= WHOLE_MIN_SHARE else "part"


def view_of(drive: Drive) -> PlanView:
    scenario = drive.scenario
    return PlanView((scenario.height, scenario.width), scenario.focal_px, mount_of(drive))


def mount_of(drive: Drive) -> Ground:
    return Ground.of_mount(drive.mount.believed_height_m, drive.mount.believed_pitch)


def depth_of(drive: Drive, truth: DriveTruth) -> Depth:
    """Return the frame as the robot looks at it."""
    return drop_flying_pixels(truth.depth) if drive.time_of_flight else truth.depth


def draw_samples(drive: Drive, every: int) -> Iterator[Sample]:
    """Yield the bodies of every n-th frame; ground and walls follow all of these."""
    renderer, plan = DriveRenderer(drive), view_of(drive)
    for index in range(0, drive.scenario.frame_count, every):
        truth = renderer.truth(index)
        view = plan.look(depth_of(drive, truth))
        for body in measure_bodies(view, plan.focal_px):
            yield sample_of(body, view, truth)


def sample_of(body: Body, view: LevelView, truth: DriveTruth) -> Sample:
    labels = truth.labels[::STEP_PX, ::STEP_PX]
    counts = np.bincount(labels[view.labels == body.label], minlength=3)
    number = int(counts[1:].argmax()) + 1
    first, second = np.sort(counts[1:])[:-3:-1]
    visible = int(np.count_nonzero((labels == number) & (view.depth > 0)))
    share = 1 / body.pixels_count
    return Sample(float(first * share), float(second * share), float(first / max(1, visible)), body.cues)

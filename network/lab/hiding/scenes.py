"""The judge's scenes by seed and stratum, disjoint for training and judging; and an attacker's view of one."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from clients.robot.sensing.sensor_events import Depth, Mask
from clients.robot.synthetic.scenario import Scenario, without
from clients.robot.synthetic.scenes import PAIR_STRATA, draw_scene

LEARNING, JUDGING = 1, 2
DURATION_S = 12.0
BLUR_PX = 51  # the Gaussian of the paper's prototype


@dataclass(frozen=True, slots=True)
class Scene:
    """One drawn scene: seed, number, stratum, scenario."""

    seed: int
    number: int
    stratum: str
    scenario: Scenario

    @property
    def owners(self) -> dict[str, int]:
        return {person.alias: n for n, person in enumerate(self.scenario.people, start=1) if person.tagged}

    def alone(self, alias: str) -> Scenario:
        return without(self.scenario, *(person.alias for person in self.scenario.people if person.alias != alias))


def draw_scenes(seed: int, count: int, purpose: int, *, duration_s: float = DURATION_S) -> list[Scene]:
    """Two or three people, cycling through the strata. No scene of one purpose is drawn for another."""
    scenes = []
    for number in range(count):
        stratum = PAIR_STRATA[number % len(PAIR_STRATA)]
        entropy = int(np.random.SeedSequence([seed, purpose, number]).generate_state(1)[0])
        scenes.append(Scene(seed, number, stratum, draw_scene(entropy, stratum, duration_s=duration_s)))
    return scenes


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A half-resolution picture: depth in mm, median empty frame, owner's pixels.

    Every attacker gets the owner's outline, as a thief may know the owner.
    """

    picture: Depth
    empty: Depth
    owner: Mask


def half_view(picture: Depth, empty: Depth, owner: Mask) -> View:
    return View(
        np.ascontiguousarray(picture[::2, ::2]),
        np.ascontiguousarray(empty[::2, ::2]),
        np.ascontiguousarray(owner[::2, ::2]),
    )


def show_owner_only(kept: Depth, recorded_empty: Depth) -> Depth:
    """Our rendition as displayed: the owner's non-zero pixels on a recorded empty frame."""
    return np.where(kept > 0, kept, recorded_empty)


def blur_others(picture: Depth, others: Mask) -> Depth:
    blurred = cv2.GaussianBlur(picture.astype(np.float32), (BLUR_PX, BLUR_PX), 0)
    return np.where(others, np.rint(blurred), picture).astype(np.uint16)

"""Renders a scenario: frames, empty frames, true silhouettes and tag readings. Offline, ahead of use."""

from __future__ import annotations

import numpy as np

from clients.robot.events import Depth, Facing
from clients.robot.scenario import Scenario
from clients.robot.synthetic.body import chest_distance_m, pose
from clients.robot.synthetic.corridor import Camera, Labels, draw, empty_corridor
from clients.robot.synthetic.noise import CameraNoise

RENDERER_VERSION = 3
EMPTY_FRAME_OFFSET = 1_000_000
RSSI_AT_1M_DBM = -48.0


class Renderer:
    """Draws any frame of a scenario by its index; the same scenario gives the same bytes in any process."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.camera = Camera(scenario)
        self._empty = empty_corridor(self.camera)
        self._noise = CameraNoise(self.camera.shape, scenario.focal_px, scenario.seed)

    def frame(self, index: int) -> Depth:
        """Return frame `index` as uint16 millimetres."""
        return self.frame_with_truth(index)[0]

    def frame_with_truth(self, index: int) -> tuple[Depth, Labels]:
        """Return frame `index` and its truth: 0 = nobody, n = the n-th person of the scenario (from 1)."""
        depth = self._empty.copy()
        labels = np.zeros(self.camera.shape, dtype=np.uint8)
        at_s = index / self.scenario.frame_rate
        for label, person in enumerate(self.scenario.people, start=1):
            body = pose(person, at_s)
            if body is not None:
                draw(self.camera, depth, labels, body, label)
        image, moved = self._noise.apply(depth, labels, index)
        assert moved is not None
        return image, moved

    def empty_frame(self, index: int) -> Depth:
        """Return one frame of the corridor before anyone came."""
        return self._noise.apply(self._empty, None, EMPTY_FRAME_OFFSET + index)[0]


class Reading:
    """One synthetic tag reading: time, alias and what the reader measured."""

    __slots__ = ("alias", "antenna", "at_s", "distance_m", "facing", "rssi_dbm", "sigma_m")

    def __init__(
        self, alias: str, at_s: float, distance_m: float, scenario: Scenario, rng: np.random.Generator
    ) -> None:
        reader = scenario.reader
        self.alias = alias
        self.at_s = at_s
        self.sigma_m = reader.distance_sigma_m
        self.distance_m = max(0.1, distance_m + float(rng.normal(0, self.sigma_m)))
        heard_in_front = bool(rng.random() >= reader.front_misread)
        self.facing = Facing.FRONT if heard_in_front else Facing.BACK
        self.antenna = reader.antenna_front if heard_in_front else reader.antenna_back
        self.rssi_dbm = RSSI_AT_1M_DBM - 20 * float(np.log10(distance_m)) + float(rng.normal(0, 1.5))


def readings(scenario: Scenario) -> list[Reading]:
    """Return all tag readings of a scenario in time order."""
    made = []
    for number, person in enumerate(scenario.people):
        rng = np.random.default_rng([scenario.seed, 2, number])
        for at_s in person.reading_times_s():
            distance = chest_distance_m(person, at_s, scenario.camera_height_m)
            if distance is not None:
                made.append(Reading(person.alias, at_s, distance, scenario, rng))
    return sorted(made, key=lambda reading: reading.at_s)

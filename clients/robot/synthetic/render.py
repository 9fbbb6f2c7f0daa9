"""Offline scenario rendering: frames, empty frames, true silhouettes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from clients.robot.sensing.sensor_events import Depth
from clients.robot.synthetic.body import Capsules, pose
from clients.robot.synthetic.camera import AID_BIT, Camera, Image, Labels, draw
from clients.robot.synthetic.corridor import empty_corridor
from clients.robot.synthetic.environment import furnish, mirror, patches
from clients.robot.synthetic.noise import CameraNoise
from clients.robot.synthetic.scenario import Scenario

RENDERER_VERSION = 3
EMPTY_FRAME_OFFSET = 1_000_000


@dataclass(frozen=True, slots=True, eq=False)
class GroundTruth:
    """A frame with `labels` (0 = nobody) and `props` (pixels of an aid)."""

    depth: Depth
    labels: Labels
    props: Labels


class Renderer:
    """Renders frames by index, byte-identical across processes."""

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.camera = Camera(scenario)
        self._bare = empty_corridor(self.camera)
        self._noise = _noise_of(self.camera.shape, scenario.focal_px, scenario.seed, scenario.environment.holes)

    def frame(self, index: int) -> Depth:
        """As uint16 millimetres."""
        return self.frame_with_truth(index)[0]

    def frame_with_truth(self, index: int) -> tuple[Depth, Labels]:
        """Labels: 0 = nobody, n = n-th person or their aid."""
        truth = self.truth(index)
        return truth.depth, truth.labels

    def truth(self, index: int) -> GroundTruth:
        at_s = index / self.scenario.frame_rate
        depth = self._corridor(at_s)
        labels = np.zeros(self.camera.shape, dtype=np.uint8)
        bodies = []
        for label, person in enumerate(self.scenario.people, start=1):
            body = pose(person, at_s) if person.alias not in self.scenario.absent else None
            if body is not None:
                draw(self.camera, depth, labels, body, label, label | AID_BIT)
                bodies.append((body, 0))
        self._mirror(depth, labels, bodies)
        image, moved = self._noise.apply(depth, labels, index)
        assert moved is not None
        own = moved & np.uint8(AID_BIT - 1)
        return GroundTruth(image, own, np.where(moved >= AID_BIT, own, np.uint8(0)))

    def empty_frame(self, index: int) -> Depth:
        """From the robot's first position."""
        return self._noise.apply(self._empty_of(0.0), None, EMPTY_FRAME_OFFSET + index)[0]

    def _empty_of(self, at_s: float) -> Image:
        depth = self._corridor(at_s)
        self._mirror(depth, np.zeros(depth.shape, np.uint8), [])
        return depth

    def _mirror(self, depth: Image, labels: Labels, bodies: list[tuple[Capsules, int]]) -> None:
        share = self.scenario.environment.mirror_floor
        if share > 0:  # the patches are at fixed pixels
            mirror(self.camera, depth, labels, bodies, *patches(depth.shape, share, self.scenario.seed))

    def _corridor(self, at_s: float) -> Image:
        at = self.scenario.camera_at(at_s)
        if at != self.camera.at:
            self.camera.at = at
            self._bare = empty_corridor(self.camera)
        depth = self._bare.copy()
        furnish(self.camera, depth, self.scenario.environment, at_s)
        return depth


@lru_cache(maxsize=4)
def _noise_of(shape: tuple[int, int], focal_px: float, seed: int, holes: float) -> CameraNoise:
    return CameraNoise(shape, focal_px, seed, holes)

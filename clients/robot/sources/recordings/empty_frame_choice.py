"""Picks a bounded, evenly spread set of empty-scene frames."""

from __future__ import annotations

from clients.robot.sensing.sensor_events import Depth

EMPTY_FRAMES_READ_MAX_COUNT = 300
EMPTY_FRAMES_MAX_COUNT = 64
EMPTY_FRAMES_MAX_BYTES = 256 * 1024 * 1024


class EmptyFrames:
    """Collects frames one by one, all of the first's size."""

    def __init__(self) -> None:
        self.frames: list[Depth] = []
        self._usable_count = 0
        self._step = 1

    @property
    def is_enough(self) -> bool:
        return self._usable_count >= EMPTY_FRAMES_READ_MAX_COUNT

    def add(self, depth: Depth) -> None:
        if self.frames and depth.shape != self.frames[0].shape:
            return
        if self._usable_count % self._step == 0:
            self.frames.append(depth)
        if len(self.frames) > max(1, min(EMPTY_FRAMES_MAX_COUNT, EMPTY_FRAMES_MAX_BYTES // depth.nbytes)):
            self.frames, self._step = self.frames[::2], 2 * self._step
        self._usable_count += 1

"""Watches one person with one tag walk before the camera, to measure the robot's antennas."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from clients.robot.hiding.background import Background, fits
from clients.robot.hiding.segmentation import segment
from clients.robot.sensing.antenna_calibration import Calibration, calibrate
from clients.robot.sensing.camera_intrinsics import FOCAL_DEFAULT_PX
from clients.robot.sensing.sensor_clocks import RunClocks
from clients.robot.sensing.sensor_events import Frame, Odometry, Sighting, SourceEvent
from consensus.errors import BlockRobotError

READINGS_MAX_COUNT = 100_000
FRAMES_MAX_COUNT = 100_000


class AntennaWalk:
    """Gathers where the one person in view was, and how loud each tag was heard."""

    def __init__(self, background: Background, focal_px: float = FOCAL_DEFAULT_PX) -> None:
        self._background = background
        self.focal_px = focal_px
        self._clocks = RunClocks()
        self._seen: list[tuple[int, float]] = []
        self._sightings: list[Sighting] = []
        self.several_count = 0
        """How many frames showed more than one person."""

    def watch(self, events: Iterable[SourceEvent]) -> None:
        for event in events:
            self.watch_one(event)

    def watch_one(self, event: SourceEvent) -> None:
        if isinstance(event, Frame | Sighting):
            for admitted in self._clocks.admit(event):
                if isinstance(admitted, Frame):
                    self._look(admitted)
                elif not isinstance(admitted, Odometry) and len(self._sightings) < READINGS_MAX_COUNT:
                    self._sightings.append(admitted)

    def _look(self, frame: Frame) -> None:
        if frame.depth.shape != self._background.shape or not fits(self._background, frame.depth):
            return
        people = segment(frame.depth, self._background, self.focal_px).silhouettes
        self.several_count += len(people) > 1
        if len(people) == 1 and len(self._seen) < FRAMES_MAX_COUNT:
            self._seen.append((frame.captured_at_ms, people[0].bearing_deg))

    def calibrate(self) -> Calibration:
        """By the tag that was heard most. Raises CALIBRATION_FAILED."""
        if not self._seen or not self._sightings:
            what = "nobody was seen alone" if not self._seen else "no tag was heard"
            raise BlockRobotError("CALIBRATION_FAILED", f"In the whole recording {what}.", reason="nobody")
        tag, _ = Counter(sighting.uid for sighting in self._sightings).most_common(1)[0]
        return calibrate(sorted(self._seen), [one for one in self._sightings if one.uid == tag])

"""Synthetic corridor as a live source, rendered on demand; late frames are skipped."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import AsyncIterator, Iterator, Mapping
from dataclasses import replace

from clients.robot.sensing.sensor_events import Depth, Frame, Sighting, SourceEvent
from clients.robot.sources.source import Clock, SystemClock
from clients.robot.synthetic.render import Renderer
from clients.robot.synthetic.scenario import Scenario
from clients.robot.synthetic.scenario_bag import RUN_START_MS, frame_time_ms, scene_sightings
from consensus.errors import BlockRobotError

_Due = tuple[int, Sighting | int]
"""When something comes, in milliseconds, and what: a sighting, or the scenario's frame of this index."""


class SyntheticSource:
    """A scenario; `uids` maps aliases to UIDs; `frames_per_s` thins frames, `endless` loops. Raises
    CONFIGURATION_INVALID.
    """

    def __init__(
        self,
        scenario: Scenario,
        uids: Mapping[str, str],
        *,
        frames_per_s: float | None = None,
        endless: bool = False,
    ) -> None:
        missing = [alias for alias in scenario.tagged_aliases if not uids.get(alias)]
        if missing:
            raise BlockRobotError("CONFIGURATION_INVALID", f"No tag is given for {', '.join(missing)}.")
        self.shift_ms = 0
        self._scenario = scenario
        self._sightings = scene_sightings(scenario, uids)
        self._renderer = Renderer(scenario)
        self._step = max(1, round(scenario.frame_rate / frames_per_s)) if frames_per_s else 1
        self._endless = endless

    @property
    def start_ms(self) -> int:
        """First event's time, `shift_ms` included."""
        first_ms = min([RUN_START_MS, *(at_ms for at_ms, _ in self._sightings[:1])])
        return first_ms + self.shift_ms

    @property
    def focal_px(self) -> float:
        return self._scenario.focal_px

    @property
    def focal_from(self) -> str:
        return "scenario"

    def shift_to(self, start_ms: int) -> None:
        self.shift_ms += start_ms - self.start_ms

    def empty_frames(self) -> list[Depth]:
        return [self._renderer.empty_frame(number) for number in range(1, self._scenario.empty_frames + 1)]

    def events(self) -> Iterator[SourceEvent]:
        """In receipt order."""
        sequences = itertools.count()
        for at_ms, what in self._timeline():
            if isinstance(what, Sighting):
                yield what
            else:
                yield Frame(at_ms, next(sequences), self._renderer.frame(what), at_ms)

    async def play(self, clock: Clock | None = None) -> AsyncIterator[SourceEvent]:
        ticking = clock or SystemClock()
        period_ms = self._step * 1000 / self._scenario.frame_rate
        sequences = itertools.count()
        for at_ms, what in self._timeline():
            await ticking.sleep_until(at_ms)
            if isinstance(what, Sighting):
                yield what
            elif ticking.now_ms() < at_ms + period_ms:
                depth = await asyncio.to_thread(self._renderer.frame, what)
                yield Frame(at_ms, next(sequences), depth, ticking.now_ms())

    def _timeline(self) -> Iterator[_Due]:
        for lap in itertools.count() if self._endless else range(1):
            shift_ms = self.shift_ms + lap * round(self._scenario.duration_s * 1000)
            for at_ms, what in self._lap():
                yield at_ms + shift_ms, _moved(what, at_ms, shift_ms) if isinstance(what, Sighting) else what

    def _lap(self) -> Iterator[_Due]:
        """Sightings precede frames of equal time."""
        waiting = iter(self._sightings)
        pending = next(waiting, None)
        for index in range(0, self._scenario.frame_count, self._step):
            at_ms = frame_time_ms(self._scenario, index)
            while pending is not None and pending[0] <= at_ms:
                yield pending
                pending = next(waiting, None)
            yield at_ms, index
        while pending is not None:
            yield pending
            pending = next(waiting, None)


def _moved(sighting: Sighting, arrives_ms: int, shift_ms: int) -> Sighting:
    return replace(
        sighting,
        first_seen_ms=sighting.first_seen_ms + shift_ms,
        last_seen_ms=sighting.last_seen_ms + shift_ms,
        received_at_ms=arrives_ms + shift_ms,
    )

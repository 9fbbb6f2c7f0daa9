"""The synthetic corridor as a source, rendered as it is asked for: nothing is kept, and nothing is written.

One core renders about fifteen frames a second at 640 x 480; for more, render a recording first (`clients.robot.bag`).
Must never be given the UID of a real tag.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator, Mapping
from dataclasses import replace

from clients.robot.bag import RUN_START_MS, frame_time_ms, scene_sightings
from clients.robot.events import Depth, Frame, Sighting, SourceEvent
from clients.robot.scenario import Scenario
from clients.robot.sources.source import Clock, play_events
from clients.robot.synthetic.render import Renderer
from consensus.errors import BlockRobotError


class SyntheticSource:
    """One scenario. `uids` maps each tagged alias to a tag's UID. Raises CONFIGURATION_INVALID when one is missing."""

    def __init__(self, scenario: Scenario, uids: Mapping[str, str]) -> None:
        missing = [alias for alias in scenario.tagged_aliases if not uids.get(alias)]
        if missing:
            raise BlockRobotError("CONFIGURATION_INVALID", f"No tag is given for {', '.join(missing)}.")
        self.shift_ms = 0
        self._scenario = scenario
        self._sightings = scene_sightings(scenario, uids)
        self._renderer = Renderer(scenario)

    @property
    def start_ms(self) -> int:
        """When the first event happens, `shift_ms` included."""
        first_ms = min([RUN_START_MS, *(at_ms for at_ms, _ in self._sightings[:1])])
        return first_ms + self.shift_ms

    @property
    def focal_px(self) -> float:
        """The focal length of the scenario's camera."""
        return self._scenario.focal_px

    def shift_to(self, start_ms: int) -> None:
        """Move the timeline so that the first event happens at `start_ms`."""
        self.shift_ms += start_ms - self.start_ms

    def empty_frames(self) -> list[Depth]:
        """Return the frames of the empty corridor."""
        return [self._renderer.empty_frame(number) for number in range(1, self._scenario.empty_frames + 1)]

    def events(self) -> Iterator[SourceEvent]:
        """Yield frames and sightings as they would be received."""
        waiting = iter(self._sightings)
        pending = next(waiting, None)
        for index in range(self._scenario.frame_count):
            at_ms = frame_time_ms(self._scenario, index)
            while pending is not None and pending[0] <= at_ms:
                yield self._shifted(*pending)
                pending = next(waiting, None)
            now_ms = at_ms + self.shift_ms
            yield Frame(now_ms, index, self._renderer.frame(index), now_ms)
        while pending is not None:
            yield self._shifted(*pending)
            pending = next(waiting, None)

    def play(self, clock: Clock | None = None) -> AsyncIterator[SourceEvent]:
        """Yield the same events, each no earlier than `clock` says it is received."""
        return play_events(self.events(), clock)

    def _shifted(self, arrives_ms: int, sighting: Sighting) -> Sighting:
        return replace(
            sighting,
            first_seen_ms=sighting.first_seen_ms + self.shift_ms,
            last_seen_ms=sighting.last_seen_ms + self.shift_ms,
            received_at_ms=arrives_ms + self.shift_ms,
        )

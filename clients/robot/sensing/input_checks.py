"""Passes usable events and counts the rest by reason.

Broken or useless streams and expired run validity end here; `fault` says why.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from typing import Annotated

from clients.robot.sensing.sensor_events import (
    AudioClip,
    ColourFrame,
    Event,
    Frame,
    Label,
    Odometry,
    RefusedMessage,
    SensorSample,
    Sighting,
    SourceEvent,
)
from clients.sdk.terminal.json_answers import Answer, doc
from consensus.errors import BlockRobotError

REFUSED_IN_A_ROW_MAX_COUNT = 300
NOTED_EACH_COUNT = 300
"""So many refusals of one kind and reason are noted one by one, those after them so many at once:"""

NOTED_TOGETHER_COUNT = 1_000

RUN_ENDS = frozenset(
    {
        "ROSTER_EXPIRED",
        "BACKGROUND_NOT_FOUND",
        "BACKGROUND_INVALID",
        "BACKGROUND_NOT_APPROVED",
        "BACKGROUND_EXPIRED",
    }
)
"""The errors of `RunValidity.check`: a run that meets one ends in good order."""

_FAULTS = frozenset({"BAG_DAMAGED", "FEED_LOST"}) | RUN_ENDS


class RunFault(Answer, frozen=True, kw_only=True):
    """What ended a source, or a run."""

    code: Annotated[str, doc("The error's code")]
    detail: Annotated[str, doc("What happened")]


class Inputs:
    """Input checks; `shape`: required (height, width); live sources fail by frames only, none by odometry."""

    def __init__(
        self, shape: tuple[int, int], note: Callable[[RefusedMessage, int], None] | None = None, *, live: bool = False
    ) -> None:
        self.refused: dict[str, dict[str, int]] = {}
        self.first_detail: dict[str, str] = {}
        self.fault: BlockRobotError | None = None
        self._shape = shape
        self._note = note or (lambda _refused, _count: None)
        self._live = live
        self._unnoted: dict[tuple[str, str], tuple[RefusedMessage, int]] = {}
        self._in_a_row: dict[str, int] = {}

    async def usable(self, events: AsyncIterator[SourceEvent]) -> AsyncIterator[Event | SensorSample]:
        try:
            async for event in events:
                refused = self._check(event)
                if refused is not None:
                    self._refuse(refused)
                else:
                    self._in_a_row[_KINDS[type(event)]] = 0
                if not isinstance(event, RefusedMessage) and refused is None:
                    yield event
                if self.fault is not None:
                    return
        except BlockRobotError as error:
            if error.code not in _FAULTS:
                raise
            self.fault = error

    def close(self) -> None:
        for refused, count in self._unnoted.values():
            self._note(refused, count)
        self._unnoted.clear()

    def summarise_refused(self) -> dict[str, dict[str, int]]:
        """By kind and reason."""
        return {kind: dict(sorted(found.items())) for kind, found in self.refused.items()}

    def summarise_fault(self) -> RunFault | None:
        return None if self.fault is None else RunFault(code=self.fault.code, detail=self.fault.detail)

    def _check(self, event: SourceEvent) -> RefusedMessage | None:
        if isinstance(event, Frame) and event.depth.shape != self._shape:
            return RefusedMessage(event.captured_at_ms, "frame", "size")
        if isinstance(event, ColourFrame) and event.registered and event.pixels.shape[:2] != self._shape:
            return RefusedMessage(event.at_ms, "rgb", "size")
        return event if isinstance(event, RefusedMessage) else None

    def _refuse(self, refused: RefusedMessage) -> None:
        counts = self.refused.setdefault(refused.kind, {})
        counts[refused.reason] = counts.get(refused.reason, 0) + 1
        if refused.detail:
            self.first_detail.setdefault(refused.kind, refused.detail)
        self._note_it(refused, counts[refused.reason])
        in_a_row = self._in_a_row.get(refused.kind, 0) + 1
        self._in_a_row[refused.kind] = in_a_row
        ends_run = refused.kind == "frame" or not (self._live or refused.kind == "odometry")  # recordings do without it
        if in_a_row < REFUSED_IN_A_ROW_MAX_COUNT or not ends_run:
            return
        why = (refused.detail or refused.reason).removesuffix(".")
        detail = f"{in_a_row} messages in a row were no usable {KIND_WORDS[refused.kind]}, the last: {why}."
        self.fault = BlockRobotError("FRAMES_UNUSABLE", detail)

    def _note_it(self, refused: RefusedMessage, number: int) -> None:
        if number <= NOTED_EACH_COUNT:
            self._note(refused, 1)
            return
        what = (refused.kind, refused.reason)
        count = self._unnoted.pop(what, (refused, 0))[1] + 1
        if count == NOTED_TOGETHER_COUNT:
            self._note(refused, count)
        else:
            self._unnoted[what] = (refused, count)


KIND_WORDS = {
    "frame": "depth images",
    "sighting": "tag readings",
    "rgb": "colour images",
    "label": "estimates",
    "audio": "stretches of sound",
    "odometry": "places of odometry",
}
"""What messages of each kind are called in sentences."""

_KINDS: dict[type, str] = {
    Frame: "frame",
    Sighting: "sighting",
    ColourFrame: "rgb",
    Label: "label",
    AudioClip: "audio",
    Odometry: "odometry",
}

"""The camera's focal length; a live first frame waits for it."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from typing import Annotated, Protocol

from clients.robot.sensing.sensor_events import Frame, SourceEvent
from clients.sdk.terminal.json_answers import Answer, Count, doc

FOCAL_DEFAULT_PX = 525.0
FOCAL_WAIT_MAX_S = 2.0
ASSUMED = "assumed"
_ASK_EVERY_S = 0.05


class Lens(Protocol):
    """A source of frames that may learn the focal length only later."""

    @property
    def focal_px(self) -> float | None: ...

    @property
    def focal_from(self) -> str: ...


class CameraFigures(Answer, frozen=True, kw_only=True):
    """The camera's lens."""

    focal_px: Annotated[float, doc("Focal length in pixels")]
    focal_from: Annotated[str, doc("Where that is from")]
    frames_before: Annotated[Count, doc("How many frames came before it was known")]


class CameraIntrinsics:
    """`source`'s focal length; `use` receives it, until then the FrameRedactor's default."""

    def __init__(self, source: Lens, use: Callable[[float], None], *, live: bool) -> None:
        self._source = source
        self._use = use
        self._live = live
        self._waits = live
        self._frames_before = 0
        self._focal_px: float | None = None
        self._take()

    async def learnt(self, events: AsyncIterator[SourceEvent]) -> AsyncIterator[SourceEvent]:
        """A live first frame waits `FOCAL_WAIT_MAX_S` at most."""
        async for event in events:
            if self._focal_px is None and isinstance(event, Frame):
                if self._live:  # a recording gives it at the start, or never
                    await self._wait()
                self._frames_before += self._focal_px is None
            yield event

    def summarise(self) -> CameraFigures:
        is_known = self._focal_px is not None
        return CameraFigures(
            focal_px=FOCAL_DEFAULT_PX if self._focal_px is None else round(self._focal_px, 3),
            focal_from=self._source.focal_from if is_known else ASSUMED,
            frames_before=self._frames_before,
        )

    async def _wait(self) -> None:
        loop = asyncio.get_running_loop()
        until_s = loop.time() + (FOCAL_WAIT_MAX_S if self._waits else 0)
        self._waits = False
        self._take()
        while self._focal_px is None and loop.time() < until_s:
            await asyncio.sleep(_ASK_EVERY_S)
            self._take()

    def _take(self) -> None:
        self._focal_px = self._source.focal_px
        if self._focal_px is not None:
            self._use(self._focal_px)

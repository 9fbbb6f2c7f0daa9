"""Colour, estimates and sound, from source to sealed clips.

Registered colour is cut by the owner's silhouette; the rest needs exactly one registered person present. The queue is
bounded.
"""

from __future__ import annotations

import asyncio
import json
import wave
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from io import BytesIO
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from clients.robot.consent.consent_filter import ConsentFilter
from clients.robot.consent.consent_view import Consents
from clients.robot.hiding.cut import Cut
from clients.robot.hiding.hider import Kept, Withheld
from clients.robot.pairing.occupancy import OccupancyMonitor
from clients.robot.recording.batching import Batcher, ReadyClip
from clients.robot.recording.sealing import ClipContent, seal_clip
from clients.robot.recording.spool import SpooledClip
from clients.robot.recording.unclosed_visits import OpenVisits
from clients.robot.recording.visit_book import VisitBook
from clients.robot.run.event_log import IMAGE_WITHHELD, SENSE_WITHHELD, EventLog
from clients.robot.run.run_statistics import RunStatistics
from clients.robot.sensing.sensor_events import AudioClip, ColourFrame, Label, SensorSample
from consensus.errors import BlockRobotError
from consensus.members.roster import RosterRow
from consensus.primitives.hashing import HASH_SIZE_BYTES
from consensus.records.metadata import NOTICE_SENSOR
from consensus.records.renditions import (
    ENCODING_JPEG,
    ENCODING_LABEL,
    ENCODING_PNG_RGBA,
    ENCODING_WAV,
    RENDITION_VERSION,
    Rendition,
)

WAITING_MAX_COUNT = 4_096
"""Of each sense: how many wait with what they hold."""

WAITING_MAX_BYTES = 128 * 1024 * 1024
"""Of all senses together."""

EMPTY_MAX_COUNT = 65_536
"""Of each sense: how many wait altogether, also those that hold nothing any more."""

NO_ROOM = "no-room"
"""Why a person does not get what there was no memory for, until it was known whose it is."""

SENSORS: dict[type, str] = {ColourFrame: "rgb", Label: "emotion", AudioClip: "audio"}
NO_BACKGROUND = bytes(HASH_SIZE_BYTES)
_JPEG_QUALITY = 90
_PNG_LEVEL = 1


@dataclass(frozen=True, slots=True)
class SampleKept(Kept):
    """One person's sample of a sense; bytes in the cut's `encoding`."""

    encoding: str = ""
    width: int = 1
    height: int = 1


@dataclass(slots=True)
class _Waiting:
    sensor: str
    sequence: int
    start_ms: int
    end_ms: int
    encoding: str
    width: int
    height: int
    data: bytes
    is_empty: bool = False


class _Queue:
    def __init__(self) -> None:
        self.size_bytes = 0
        self._held_count = 0
        self._waiting: deque[_Waiting] = deque()

    def __len__(self) -> int:
        return len(self._waiting)

    @property
    def first(self) -> _Waiting:
        return self._waiting[0]

    @property
    def is_too_long(self) -> bool:
        return self._held_count > WAITING_MAX_COUNT

    def add(self, waiting: _Waiting) -> None:
        self._waiting.append(waiting)
        self._count(waiting, 1)

    def pop(self) -> None:
        self._count(self._waiting.popleft(), -1)

    def empty_last(self) -> None:
        """Drop the newest sample's data; earlier ones are decided sooner."""
        last = next(waiting for waiting in reversed(self._waiting) if not waiting.is_empty)
        self._count(last, -1)
        last.data, last.is_empty = b"", True

    def _count(self, waiting: _Waiting, sign: int) -> None:
        if not waiting.is_empty:
            self._held_count += sign
            self.size_bytes += sign * len(waiting.data)


class _SenseLog(EventLog):
    def __init__(self, log: EventLog, sensor: str) -> None:
        self._log, self._sensor = log, sensor

    def write(self, time_ms: int, activity: str, case: str, *, alias: str = "", **detail: str | int | float) -> None:
        own = SENSE_WITHHELD if activity == IMAGE_WITHHELD else activity
        self._log.write(time_ms, own, f"{self._sensor}-{case.rpartition('-')[2]}", alias=alias, **detail)


class SensorTracks:
    """A run's non-depth senses, each with own consent, batches and figures."""

    def __init__(
        self,
        consents: Consents,
        visits: VisitBook,
        open_visits: OpenVisits,
        *,
        statistics: RunStatistics,
        log: EventLog,
        purpose: str,
        clip_ms: int,
        people: dict[str, RosterRow],
        now_ms: Callable[[], int],
    ) -> None:
        self.alone = OccupancyMonitor(statistics.window_ms)
        self._visits, self._open_visits = visits, open_visits
        self._statistics = statistics
        self._now_ms = now_ms
        self._batchers = {sensor: Batcher(clip_ms) for sensor in SENSORS.values()}
        self._keepers = {}
        for sensor, batcher in self._batchers.items():
            statistics.senses[sensor] = RunStatistics(window_ms=statistics.window_ms)
            self._keepers[sensor] = ConsentFilter(
                consents,
                batcher,
                visits,
                statistics=statistics.senses[sensor],
                log=_SenseLog(log, sensor),
                purpose=purpose,
                sensor=sensor,
                now_ms=now_ms,
            )
            self._keepers[sensor].people = people
        self._waiting = {sensor: _Queue() for sensor in SENSORS.values()}
        self._sealed: list[SpooledClip] = []

    async def take(self, sense: SensorSample, *, camera_offset_ms: int = 0) -> None:
        """Add a sample; `camera_offset_ms` is host clock minus camera clock."""
        sensor = SENSORS[type(sense)]
        self._statistics.senses[sensor].frame_arrived(sense.sequence, self._now_ms())
        own = self._waiting[sensor]
        own.add(await asyncio.to_thread(_pack, sense, camera_offset_ms))
        if own.is_too_long:
            self._let_go(sensor)
        while sum(queue.size_bytes for queue in self._waiting.values()) > WAITING_MAX_BYTES:
            self._let_go(max(self._waiting, key=lambda name: self._waiting[name].size_bytes))
        if len(own) > EMPTY_MAX_COUNT:
            self._conclude_first(own, final=True)

    def _let_go(self, sensor: str) -> None:
        self._statistics.senses[sensor].let_go += 1
        self._waiting[sensor].empty_last()

    def drop_refused(self) -> None:
        """Drop samples of people who no longer consent."""
        for keeper in self._keepers.values():
            keeper.drop_refused()

    def settle(self, *, final: bool = False) -> list[SpooledClip]:
        """Return sealed clips of everything settled; `final`: end of input."""
        for queue in self._waiting.values():
            while queue and self._conclude_first(queue, final=final):
                pass
        sealed = []
        for sensor, batcher in self._batchers.items():
            ready = batcher.flush() if final else batcher.close_idle(self._now_ms())
            sealed += self._seal(sensor, ready)
        sealed, self._sealed = [*self._sealed, *sealed], []
        return sealed

    def _conclude_first(self, queue: _Queue, *, final: bool) -> bool:
        if not self._conclude(queue.first, final=final):
            return False
        queue.pop()
        return True

    def _conclude(self, waiting: _Waiting, *, final: bool) -> bool:
        """Give everybody present their part or a reason; False: not settled."""
        if waiting.encoding == ENCODING_PNG_RGBA:
            verdicts = self.alone.silhouettes(waiting.start_ms, final=final)
        else:
            verdicts = self._whole(waiting, final=final)
        if verdicts is None:
            return False
        keeper = self._keepers[waiting.sensor]
        self._statistics.senses[waiting.sensor].covered += len(verdicts)
        for verdict in verdicts:
            output: Kept | Withheld = replace(verdict, sequence=waiting.sequence, captured_at_ms=waiting.start_ms)
            if isinstance(output, Kept) and waiting.is_empty:
                keeper.withhold(output, NO_ROOM)
                continue
            if isinstance(output, Kept):
                output = _cut_out(output, waiting)
            self._sealed += self._seal(waiting.sensor, keeper.take(output))
        return True

    def _whole(self, waiting: _Waiting, *, final: bool) -> list[Kept | Withheld] | None:
        judged = self.alone.judge(waiting.start_ms, waiting.end_ms, final=final)
        if judged is None:
            return None
        everything = Cut(0, 0, waiting.width, waiting.height, waiting.data)
        return [
            Kept(waiting.sequence, waiting.start_ms, alias, everything, alone=True)
            if alias == judged.keeper
            else Withheld(waiting.sequence, waiting.start_ms, alias, judged.reason)
            for alias in judged.owners
        ]

    def _seal(self, sensor: str, clips: list[ReadyClip]) -> list[SpooledClip]:
        keeper, sealed = self._keepers[sensor], []
        for clip in clips:
            admitted = keeper.admit(clip)
            if admitted is not None:
                sealed.append(self._seal_one(sensor, admitted))
        return sealed

    def _seal_one(self, sensor: str, clip: ReadyClip) -> SpooledClip:
        keeper, now = self._keepers[sensor], self._now_ms()
        chain = self._visits.chain_for(clip.alias, keeper.people[clip.alias], now)
        content = ClipContent(
            renditions=tuple(_rendition(frame) for frame in clip.frames) or (_notice(now),),
            withheld=clip.withheld,
            sensor=sensor if clip.frames else NOTICE_SENSOR,
            decided_at_ms=now,
            person=keeper.person_of(clip.alias),
            taken_by=sensor,
            offset_ms=keeper.offset_ms if clip.frames else 0,
        )
        spooled = seal_clip(content, chain, now_ms=now)
        self._open_visits.count(chain.owner, chain.record_count)
        frames = [(frame.sequence, frame.captured_at_ms) for frame in clip.frames]
        self._statistics.senses[sensor].clip_sealed(spooled.upload.record_id, frames, clip.alias)
        return spooled


def _pack(sense: SensorSample, camera_offset_ms: int) -> _Waiting:
    sensor = SENSORS[type(sense)]
    if isinstance(sense, ColourFrame):
        height, width = sense.pixels.shape[:2]
        encoding = ENCODING_PNG_RGBA if sense.registered else ENCODING_JPEG
        data = _encode(cv2.cvtColor(sense.pixels, cv2.COLOR_RGB2BGR), exact=sense.registered)
        return _Waiting(sensor, sense.sequence, sense.at_ms, sense.at_ms, encoding, width, height, data)
    at_ms = sense.at_ms - camera_offset_ms
    if isinstance(sense, Label):
        told: dict[str, Any] = {"label": sense.text}
        if sense.confidence is not None:
            told["confidence"] = round(sense.confidence, 4)
        data = json.dumps(told, ensure_ascii=False, sort_keys=True).encode()
        return _Waiting(sensor, sense.sequence, at_ms, at_ms, ENCODING_LABEL, 1, 1, data)
    ends_ms = sense.ends_ms - camera_offset_ms
    return _Waiting(sensor, sense.sequence, at_ms, ends_ms, ENCODING_WAV, 1, 1, _wav(sense))


def _wav(clip: AudioClip) -> bytes:
    packed = BytesIO()
    with wave.open(packed, "wb") as file:
        file.setnchannels(clip.channels)
        file.setsampwidth(2)
        file.setframerate(clip.rate_hz)
        file.writeframes(clip.samples)
    return packed.getvalue()


def _encode(pixels: Any, *, exact: bool) -> bytes:
    how = (
        (".png", [cv2.IMWRITE_PNG_COMPRESSION, _PNG_LEVEL])
        if exact
        else (".jpg", [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])
    )
    done, data = cv2.imencode(how[0], pixels, how[1])
    if not done:
        raise BlockRobotError("FRAME_INVALID", "A colour image could not be packed.")
    return bytes(data.tobytes())


def cut_colour(colour: npt.NDArray[np.uint8], cut: Cut) -> npt.NDArray[np.uint8]:
    """Return a depth cut's box in BGR colour as BGRA, 0 outside the owner."""
    depth = np.asarray(cv2.imdecode(np.frombuffer(cut.pixels_png, np.uint8), cv2.IMREAD_UNCHANGED))
    own = np.zeros((cut.height, cut.width, 4), np.uint8)
    mask = depth > 0
    own[mask, :3] = colour[cut.y : cut.y + cut.height, cut.x : cut.x + cut.width][mask]
    own[mask, 3] = 255
    return own


def _cut_out(kept: Kept, waiting: _Waiting) -> SampleKept:
    cut, width, height = kept.cut, waiting.width, waiting.height
    if waiting.encoding == ENCODING_PNG_RGBA:
        colour = np.asarray(cv2.imdecode(np.frombuffer(waiting.data, np.uint8), cv2.IMREAD_COLOR), dtype=np.uint8)
        cut = Cut(cut.x, cut.y, cut.width, cut.height, _encode(cut_colour(colour, cut), exact=True))
    same = (kept.sequence, kept.captured_at_ms, kept.alias, cut, kept.alone)
    return SampleKept(*same, encoding=waiting.encoding, width=width, height=height)


def _rendition(frame: Kept) -> Rendition:
    assert isinstance(frame, SampleKept)
    is_picture = frame.encoding in (ENCODING_JPEG, ENCODING_PNG_RGBA)
    return Rendition(
        version=RENDITION_VERSION,
        captured_at_ms=frame.captured_at_ms,
        sequence=frame.sequence,
        width=frame.width,
        height=frame.height,
        x=frame.cut.x,
        y=frame.cut.y,
        box_width=frame.cut.width if is_picture else 0,
        box_height=frame.cut.height if is_picture else 0,
        background_id=NO_BACKGROUND,
        encoding=frame.encoding,
        pixels=frame.cut.pixels_png,
    )


def _notice(now_ms: int) -> Rendition:
    return Rendition(RENDITION_VERSION, now_ms, 0, 1, 1, 0, 0, 0, 0, NO_BACKGROUND, ENCODING_LABEL, b"")

"""Colour, estimates and sound, waiting until depth tells whose they are.

Registered colour is cut by the owner's silhouette; the rest needs exactly one registered person present.
"""

from __future__ import annotations

import asyncio
import json
import wave
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from io import BytesIO
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from clients.robot.hiding.cutouts import EncodedCutout
from clients.robot.hiding.frame_redactor import KeptFrame, SampleForm, WithheldFrame
from clients.robot.hiding.withhold_reason import WithholdReason
from clients.robot.recording.batching import ReadyClip
from clients.robot.recording.occupancy import OccupancyMonitor
from clients.robot.recording.run_statistics import RunStatistics
from clients.robot.recording.sensor_recorder import NO_PICTURE, RunContext, SensorRecorder
from clients.robot.sensing.sensor_events import AudioClip, ColourFrame, Label, SensorSample
from consensus.errors import BlockRobotError
from consensus.members.roster import RosterRow
from consensus.records.renditions import ENCODING_JPEG, ENCODING_PNG_RGBA, ENCODING_WAV

WAITING_MAX_COUNT = 4_096
"""Of each sense: how many wait with what they hold."""

WAITING_MAX_BYTES = 128 * 1024 * 1024
"""Of all senses together."""

EMPTY_MAX_COUNT = 65_536
"""Of each sense: how many wait altogether, also those that hold nothing any more."""

SENSORS: dict[type, str] = {ColourFrame: "rgb", Label: "emotion", AudioClip: "audio"}
_JPEG_QUALITY = 90
_PNG_LEVEL = 1


@dataclass(slots=True)
class _Waiting:
    sensor: str
    sequence: int
    start_ms: int
    end_ms: int
    form: SampleForm
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


class WaitingSamples:
    """A run's samples that are not depth, and the tracks that they go to."""

    def __init__(self, run: RunContext, people: Mapping[str, RosterRow], statistics: RunStatistics) -> None:
        self.alone = OccupancyMonitor(statistics.window_ms)
        self._run = run
        self._statistics = statistics.senses
        self.tracks: dict[str, SensorRecorder] = {}
        for sensor in SENSORS.values():
            self._statistics[sensor] = RunStatistics(window_ms=statistics.window_ms)
            self.tracks[sensor] = SensorRecorder(run, sensor, people, self._statistics[sensor])
        self._waiting = {sensor: _Queue() for sensor in SENSORS.values()}
        self._ready: list[tuple[SensorRecorder, ReadyClip]] = []

    async def process(self, sample: SensorSample) -> None:
        sensor = SENSORS[type(sample)]
        self._statistics[sensor].frame_arrived(sample.sequence, self._run.now_ms())
        own = self._waiting[sensor]
        own.add(await asyncio.to_thread(_pack, sample, self._run.clocks.camera_offset_ms))
        if own.is_too_long:
            self._drop(sensor)
        while sum(queue.size_bytes for queue in self._waiting.values()) > WAITING_MAX_BYTES:
            self._drop(max(self._waiting, key=lambda name: self._waiting[name].size_bytes))
        if len(own) > EMPTY_MAX_COUNT:
            self._conclude_first(own, final=True)

    def _drop(self, sensor: str) -> None:
        self._statistics[sensor].dropped += 1
        self._waiting[sensor].empty_last()

    def drain(self, *, final: bool = False) -> list[tuple[SensorRecorder, ReadyClip]]:
        """`final`: end of input."""
        for queue in self._waiting.values():
            while queue and self._conclude_first(queue, final=final):
                pass
        for track in self.tracks.values():
            self._ready += [(track, clip) for clip in track.close(final=final)]
        ready, self._ready = self._ready, []
        return ready

    def _conclude_first(self, queue: _Queue, *, final: bool) -> bool:
        if not self._conclude(queue.first, final=final):
            return False
        queue.pop()
        return True

    def _conclude(self, waiting: _Waiting, *, final: bool) -> bool:
        """Give everybody present their part or a reason; False: not settled."""
        if waiting.form.encoding == ENCODING_PNG_RGBA:
            verdicts = self.alone.silhouettes(waiting.start_ms, final=final)
        else:
            verdicts = self._whole(waiting, final=final)
        if verdicts is None:
            return False
        track = self.tracks[waiting.sensor]
        self._statistics[waiting.sensor].covered += len(verdicts)
        for verdict in verdicts:
            output: KeptFrame | WithheldFrame = replace(
                verdict, sequence=waiting.sequence, captured_at_ms=waiting.start_ms
            )
            if isinstance(output, KeptFrame) and waiting.is_empty:
                output = WithheldFrame(output.sequence, output.captured_at_ms, output.alias, WithholdReason.NO_ROOM)
            elif isinstance(output, KeptFrame):
                output = _cut_out(output, waiting)
            self._ready += [(track, clip) for clip in track.process(output)]
        return True

    def _whole(self, waiting: _Waiting, *, final: bool) -> list[KeptFrame | WithheldFrame] | None:
        judged = self.alone.find_occupancy(waiting.start_ms, waiting.end_ms, final=final)
        if judged is None:
            return None
        everything = EncodedCutout(0, 0, waiting.form.width, waiting.form.height, waiting.data)
        return [
            KeptFrame(waiting.sequence, waiting.start_ms, alias, everything, alone=True)
            if alias == judged.sole_owner
            else WithheldFrame(waiting.sequence, waiting.start_ms, alias, judged.reason)
            for alias in judged.owners
        ]


def _pack(sample: SensorSample, camera_offset_ms: int) -> _Waiting:
    """`camera_offset_ms`: host clock minus camera clock; colour has the camera's."""
    sensor, at_ms = SENSORS[type(sample)], sample.at_ms
    if isinstance(sample, ColourFrame):
        height, width = sample.pixels.shape[:2]
        form = SampleForm(width, height, ENCODING_PNG_RGBA if sample.registered else ENCODING_JPEG)
        data = _encode(cv2.cvtColor(sample.pixels, cv2.COLOR_RGB2BGR), exact=sample.registered)
        return _Waiting(sensor, sample.sequence, at_ms, at_ms, form, data)
    at_ms -= camera_offset_ms
    if isinstance(sample, Label):
        content: dict[str, Any] = {"label": sample.text}
        if sample.confidence is not None:
            content["confidence"] = round(sample.confidence, 4)
        data = json.dumps(content, ensure_ascii=False, sort_keys=True).encode()
        return _Waiting(sensor, sample.sequence, at_ms, at_ms, NO_PICTURE, data)
    ends_ms = sample.ends_ms - camera_offset_ms
    return _Waiting(sensor, sample.sequence, at_ms, ends_ms, SampleForm(encoding=ENCODING_WAV), _wav(sample))


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


def cut_out_colour(colour: npt.NDArray[np.uint8], cutout: EncodedCutout) -> npt.NDArray[np.uint8]:
    """Return a depth cut's box of BGR colour as BGRA, 0 outside the owner."""
    depth = np.asarray(cv2.imdecode(np.frombuffer(cutout.pixels_png, np.uint8), cv2.IMREAD_UNCHANGED))
    own = np.zeros((cutout.height, cutout.width, 4), np.uint8)
    mask = depth > 0
    own[mask, :3] = colour[cutout.y : cutout.y + cutout.height, cutout.x : cutout.x + cutout.width][mask]
    own[mask, 3] = 255
    return own


def _cut_out(kept: KeptFrame, waiting: _Waiting) -> KeptFrame:
    cutout = kept.cutout
    if waiting.form.encoding == ENCODING_PNG_RGBA:
        colour = np.asarray(cv2.imdecode(np.frombuffer(waiting.data, np.uint8), cv2.IMREAD_COLOR), dtype=np.uint8)
        cutout = EncodedCutout(
            cutout.x, cutout.y, cutout.width, cutout.height, _encode(cut_out_colour(colour, cutout), exact=True)
        )
    return replace(kept, cutout=cutout, evidence=None, form=waiting.form)  # the evidence is depth's

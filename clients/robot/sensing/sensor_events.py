"""What sensors tell a robot: frames and sightings, as plain values in memory.

A `Sighting` carries the tag's UID. It must never be written, logged or sent: outside the robot's memory a tag is
known by the alias that was drawn for it in this run.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
import numpy.typing as npt

from consensus.errors import BlockRobotError

DEPTH_WIDTH_MAX_PX = 4096
DEPTH_HEIGHT_MAX_PX = 4096

DISTANCE_SIGMA_MAX_M = 2.0
"""The largest error of a distance that is taken. People whom the camera sees are about as far from each other: a reader
that errs by more does not tell where in a room somebody is, and its readings count as readings without a distance."""

Depth = npt.NDArray[np.uint16]
Mask = npt.NDArray[np.bool_]


class Facing(StrEnum):
    """Which way the antenna that read a tag looks, seen from the camera."""

    FRONT = "front"
    BACK = "back"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One depth image: uint16 millimetres along the optical axis, shape (height, width), 0 = no measurement.

    `captured_at_ms` is the camera's stamp; `received_at_ms` is the host's, None where the source cannot tell.
    """

    captured_at_ms: int
    sequence: int
    depth: Depth
    received_at_ms: int | None = None


@dataclass(frozen=True, slots=True)
class Sighting:
    """One reading of a tag, over the interval in which the reader saw it.

    `distance_m` is from the camera to the tag, with standard deviation `sigma_m`; both are None when the reader
    cannot tell. First and last seen are the reader's stamps; `received_at_ms` is the host's, None where the source
    cannot tell. `origin` says whose stamps they are: a topic, or a reader's address. The UID is left out of the printed
    form on purpose.
    """

    first_seen_ms: int
    last_seen_ms: int
    uid: str = field(repr=False)
    antenna: int = 0
    facing: Facing = Facing.UNKNOWN
    rssi_dbm: float = 0.0
    distance_m: float | None = None
    sigma_m: float | None = None
    read_count: int = 1
    received_at_ms: int | None = field(default=None, compare=False)  # the same reading may be reported twice
    origin: str = field(default="", compare=False)

    @property
    def middle_ms(self) -> int:
        """The time that stands for the whole reading."""
        return (self.first_seen_ms + self.last_seen_ms) // 2


Event = Frame | Sighting


@dataclass(frozen=True, slots=True, eq=False)
class ColourFrame:
    """One colour image: uint8, shape (height, width, 3), red first.

    `registered` says that it shows what the depth camera shows, pixel for pixel.
    """

    at_ms: int
    sequence: int
    pixels: npt.NDArray[np.uint8]
    registered: bool = False
    received_at_ms: int | None = None


@dataclass(frozen=True, slots=True)
class Label:
    """One estimate about the person before the robot, such as an emotional state, with its confidence if known."""

    at_ms: int
    sequence: int
    text: str
    confidence: float | None = None
    received_at_ms: int | None = None


@dataclass(frozen=True, slots=True)
class AudioClip:
    """A stretch of sound: 16-bit samples (little-endian, channels side by side) that began at `at_ms`."""

    at_ms: int
    sequence: int
    samples: bytes = field(repr=False)
    rate_hz: int = 16_000
    channels: int = 1
    received_at_ms: int | None = None

    @property
    def ends_ms(self) -> int:
        """When the stretch ends."""
        return self.at_ms + len(self.samples) * 1000 // (2 * self.channels * self.rate_hz)


@dataclass(frozen=True, slots=True)
class Refused:
    """A message that could not be used: what it should have been (`frame`, `sighting`, `rgb`, ...), and why.

    `detail` is a sentence about it, of what the topics file and the types say: never what the message holds.
    """

    at_ms: int
    kind: str
    reason: str
    detail: str = field(default="", compare=False)


SensorSample = ColourFrame | Label | AudioClip
SourceEvent = Event | SensorSample | Refused


def check_depth(depth: npt.NDArray[np.generic], *, shape: tuple[int, int] | None = None) -> Depth:
    """Return `depth` if it is a two-dimensional uint16 image (of `shape`, if given); raises FRAME_INVALID otherwise."""
    if depth.dtype != np.uint16 or depth.ndim != 2:
        raise BlockRobotError("FRAME_INVALID", "A depth frame must be a two-dimensional image of 16-bit millimetres.")
    height, width = depth.shape
    if not (0 < height <= DEPTH_HEIGHT_MAX_PX and 0 < width <= DEPTH_WIDTH_MAX_PX):
        raise BlockRobotError("FRAME_INVALID", f"A frame of {width}x{height} pixels is empty or too large.")
    if shape is not None and (height, width) != shape:
        raise BlockRobotError(
            "FRAME_INVALID", f"The frame has {width}x{height} pixels where {shape[1]}x{shape[0]} were expected."
        )
    return depth.astype(np.uint16, copy=False)

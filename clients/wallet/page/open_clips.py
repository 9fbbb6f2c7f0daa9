"""Verified records open in the page, in memory."""

from __future__ import annotations

import secrets
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from clients.sdk.pictures.depth_colours import Depth
from clients.sdk.pictures.rendition_files import own_depth, own_pixels, sense_file
from clients.sdk.pictures.rendition_picture import colourise, compose_on, decode_depth_png
from clients.sdk.terminal.json_answers import Answer, Hex
from clients.wallet.page.record_days import kind_of
from clients.wallet.page.record_seals import PageSeal, Seal, page_seal
from clients.wallet.presentation.translations import describe_error
from clients.wallet.records.viewing import FrameView, RecordView
from consensus.errors import BlockRobotError
from consensus.records.renditions import ENCODING_LABEL, ENCODING_PNG16, ENCODING_WAV, Rendition

HELD_MAX_BYTES = 256 << 20
CLIP_MAX_BYTES = 64 << 20
"""Records are added to a clip until it holds so much: it never holds more than that and one record."""
RECORDS_MAX_COUNT = 80
_TYPES = {"rgb.png": "image/png", "rgb.jpg": "image/jpeg", "wav": "audio/wav", "label.json": "application/json"}


class PageReason(Answer, frozen=True, kw_only=True):
    """Why empty frames are missing."""

    code: str
    sentence: str


class PageFrame(Answer, frozen=True, kw_only=True):
    """A frame of a clip; `own` is where its own picture lies."""

    number: int
    record_id: Hex
    index: int
    sequence: int | None
    captured_at_ms: int | None
    status: str
    kind: str | None
    holds: str
    width: int
    height: int
    own: list[int] | None


class PageClip(Answer, frozen=True, kw_only=True):
    """A clip."""

    clip: str
    visit: Hex
    records: list[Hex]
    seals: list[PageSeal]
    missing_rooms: list[PageReason]
    frames: list[PageFrame]


@dataclass
class OpenClip:
    """A visit's consecutive records. `rooms`: empty frames (PNG) by hash; `missing_rooms`: errors."""

    name: str
    seals: tuple[Seal, ...]
    rooms: dict[bytes, bytes]
    missing_rooms: dict[bytes, BlockRobotError]
    views: tuple[RecordView, ...] = field(init=False)
    frames: list[tuple[RecordView, FrameView]] = field(init=False)

    def __post_init__(self) -> None:
        self.views = tuple(seal.view for seal in self.seals)
        self.frames = [(view, frame) for view in self.views for frame in view.frames]

    def note_verdicts(self, heights: Mapping[bytes, int]) -> None:
        """`heights`: of the verdicts' blocks, by record."""
        self.seals = tuple(replace(seal, verdict_height=heights.get(seal.view.entry.record_id)) for seal in self.seals)

    @property
    def record_ids(self) -> set[bytes]:
        return {view.entry.record_id for view in self.views}

    @property
    def size(self) -> int:
        """The approximate size in bytes."""
        return sum(map(size_of, self.views)) + sum(map(len, self.rooms.values()))

    def rendition(self, number: int) -> Rendition:
        """Raises NOT_FOUND."""
        if not 0 <= number < len(self.frames):
            raise BlockRobotError("NOT_FOUND", f"The clip has {len(self.frames)} frames.")
        rendition = self.frames[number][1].rendition
        if rendition is None or not rendition.pixels:
            raise BlockRobotError("NOT_FOUND", f"There is nothing to show at {number}.")
        return rendition

    def depth(self, number: int, *, own: bool) -> Depth:
        """In mm, on the empty frame or (`own`) alone."""
        rendition = self.rendition(number)
        if rendition.encoding != ENCODING_PNG16:
            raise BlockRobotError("NOT_FOUND", "This is no depth picture.")
        room = self.rooms.get(rendition.background_id)
        if own or room is None:
            return own_depth(rendition)
        box = (rendition.x, rendition.y, rendition.box_width, rendition.box_height)
        return compose_on(decode_depth_png(room), *box, rendition.pixels)

    def file(self, number: int) -> tuple[str, bytes]:
        """Return media type and bytes."""
        rendition = self.rendition(number)
        if rendition.encoding == ENCODING_PNG16:
            return "image/png", colourise(self.depth(number, own=False))
        suffix, data = sense_file(rendition)
        return _TYPES[suffix], data

    def own_png(self, number: int) -> bytes:
        return own_pixels(self.rendition(number))

    def page_clip(self, language: str | None = None) -> PageClip:
        return PageClip(
            clip=self.name,
            visit=self.views[0].entry.visit.owner.hex(),
            records=[view.entry.record_id.hex() for view in self.views],
            seals=[page_seal(seal, language) for seal in self.seals],
            missing_rooms=_reasons(self.missing_rooms, language),
            frames=[_page_frame(number, view, frame) for number, (view, frame) in enumerate(self.frames)],
        )


def _reasons(missing: Mapping[bytes, BlockRobotError], language: str | None) -> list[PageReason]:
    reasons = {error.code: describe_error(error, language)[0] for error in missing.values()}
    return [PageReason(code=code, sentence=sentence) for code, sentence in reasons.items()]


def _page_frame(number: int, view: RecordView, frame: FrameView) -> PageFrame:
    rendition, meta = frame.rendition, view.entry.metadata
    is_shown = rendition is not None and bool(rendition.pixels)
    return PageFrame(
        number=number,
        record_id=view.entry.record_id.hex(),
        index=frame.index,
        sequence=None if rendition is None else rendition.sequence,
        captured_at_ms=None if rendition is None else rendition.captured_at_ms,
        status=frame.status,
        kind=_kind(rendition) if rendition is not None and is_shown else None,
        holds=kind_of(view.entry),
        width=meta.width if rendition is None else rendition.width,
        height=meta.height if rendition is None else rendition.height,
        own=[rendition.x, rendition.y, rendition.box_width, rendition.box_height]
        if rendition is not None and rendition.box_width
        else None,
    )


def size_of(view: RecordView) -> int:
    """Approximate bytes, without the empty frame."""
    return sum(len(frame.rendition.pixels) for frame in view.frames if frame.rendition is not None)


def _kind(rendition: Rendition) -> str:
    return {ENCODING_PNG16: "depth", ENCODING_WAV: "sound", ENCODING_LABEL: "label"}.get(rendition.encoding, "picture")


def little_endian(depth: Depth) -> bytes:
    """Return 16-bit values row by row."""
    return np.ascontiguousarray(depth, dtype="<u2").tobytes()


class Clips:
    """Open clips of one page, least recently used evicted."""

    def __init__(self, held_max_bytes: int = HELD_MAX_BYTES) -> None:
        self._held_max_bytes = held_max_bytes
        self._clips: dict[str, OpenClip] = {}

    def add(
        self, seals: list[Seal], rooms: dict[bytes, bytes], missing_rooms: dict[bytes, BlockRobotError]
    ) -> OpenClip:
        clip = OpenClip(secrets.token_hex(8), tuple(seals), rooms, missing_rooms)
        self._clips[clip.name] = clip
        while len(self._clips) > 1 and sum(each.size for each in self._clips.values()) > self._held_max_bytes:
            del self._clips[next(iter(self._clips))]
        return clip

    def find(self, name: str) -> OpenClip:
        """Raises CLIP_NOT_OPEN."""
        clip = self._clips.pop(name, None)
        if clip is None:
            raise BlockRobotError("CLIP_NOT_OPEN")
        self._clips[name] = clip
        return clip

    def with_record(self, record_id: bytes) -> str | None:
        for name, clip in reversed(self._clips.items()):
            if record_id in clip.record_ids:
                return name
        return None

    def count_committed(self, record_id: bytes) -> int | None:
        """Return None if the clip is not open."""
        views = [view for clip in self._clips.values() for view in clip.views if view.entry.record_id == record_id]
        return len(views[-1].frames) if views else None

    def forget(self, name: str) -> None:
        self._clips.pop(name, None)

    def forget_records(self, record_ids: Collection[bytes]) -> None:
        for name in [name for name, clip in self._clips.items() if not clip.record_ids.isdisjoint(record_ids)]:
            del self._clips[name]

    def keep_only(self, record_ids: Collection[bytes]) -> None:
        for name in [name for name, clip in self._clips.items() if not clip.record_ids.issubset(record_ids)]:
            del self._clips[name]

    def forget_all(self) -> None:
        self._clips.clear()

"""Gathers one owner's kept frames into clips, and counts withheld ones."""

from __future__ import annotations

from dataclasses import dataclass, field

from clients.robot.hiding.frame_redactor import KeptFrame
from consensus.limits import CLIP_FRAMES_MAX_COUNT

CLIP_DEFAULT_MS = 500
_CLIP_MAX_BYTES = 4 * 1024 * 1024


@dataclass(slots=True)
class OpenClip:
    """Frames gathered for one owner since the last clip."""

    frames: list[KeptFrame] = field(default_factory=list)
    withheld: dict[str, int] = field(default_factory=dict)
    size_bytes: int = 0
    added_at_ms: int = 0


@dataclass(frozen=True, slots=True)
class ReadyClip:
    """A clip ready for sealing: 1-64 frames of one owner, none for notices."""

    alias: str
    frames: tuple[KeptFrame, ...]
    withheld: tuple[tuple[str, int], ...]


class Batcher:
    """One open clip per owner; `clip_ms` 0 makes each frame a clip."""

    def __init__(self, clip_ms: int = CLIP_DEFAULT_MS) -> None:
        self._clip_ms = clip_ms
        self._open: dict[str, OpenClip] = {}

    def add_kept(self, frame: KeptFrame, now_ms: int) -> list[ReadyClip]:
        """Settled at `now_ms`; return the clips it closes."""
        clip = self._open.setdefault(frame.alias, OpenClip())
        ready = []
        if clip.frames and frame.captured_at_ms - clip.frames[0].captured_at_ms >= self._clip_ms:
            ready.append(self._close(frame.alias))
            clip = self._open.setdefault(frame.alias, OpenClip())
        clip.frames.append(frame)
        clip.size_bytes += len(frame.cutout.pixels_png)
        clip.added_at_ms = now_ms
        full = len(clip.frames) >= CLIP_FRAMES_MAX_COUNT or clip.size_bytes >= _CLIP_MAX_BYTES
        if full or self._clip_ms == 0:
            ready.append(self._close(frame.alias))
        return ready

    def add_withheld(self, alias: str, reason: str, count: int = 1) -> None:
        """Note a withheld frame; the owner's next clip reports it."""
        counts = self._open.setdefault(alias, OpenClip()).withheld
        counts[reason] = counts.get(reason, 0) + count

    def drop(self, alias: str) -> list[KeptFrame]:
        """Return an owner's waiting frames."""
        clip = self._open.pop(alias, None)
        return clip.frames if clip is not None else []

    def close_idle(self, now_ms: int) -> list[ReadyClip]:
        """Return clips without a new frame for a clip's length."""
        due = [
            alias for alias, clip in self._open.items() if clip.frames and now_ms - clip.added_at_ms >= self._clip_ms
        ]
        return [self._close(alias) for alias in due]

    def flush(self) -> list[ReadyClip]:
        return [self._close(alias) for alias in list(self._open)]

    def _close(self, alias: str) -> ReadyClip:
        clip = self._open.pop(alias)
        return ReadyClip(alias=alias, frames=tuple(clip.frames), withheld=tuple(sorted(clip.withheld.items())))

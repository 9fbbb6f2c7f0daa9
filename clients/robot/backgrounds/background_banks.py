"""Approved, expiring banks of recorded empty frames per viewpoint."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import msgspec
import numpy as np
import numpy.typing as npt

from clients.robot.hiding.background import empty_bank
from clients.robot.sensing.sensor_events import Depth, check_depth
from clients.sdk.new_files import require_own_folder, write_private
from clients.sdk.pictures.rendition_picture import colourise, decode_depth_png
from consensus.bounded_text import TextInvalidError, read_json_as
from consensus.errors import BlockRobotError

FOLDER = "empty-scenes"
NUMBERED_PICTURES = "[0-9][0-9][0-9].png"
FRAMES_MIN_COUNT = 8
FRAMES_MAX_COUNT = 45
PUBLISHED_MAX_COUNT = 8
VALID_DEFAULT_DAYS = 30
VALID_MAX_DAYS = 365
NAME_MAX_CHARS = 40
DAY_MS = 24 * 60 * 60 * 1000
# Something moved where a pixel differs by this much from the median of all frames, over an area like a head's at 5 m.
MOVED_MIN_MM = 150
MOVED_SHARE = 0.05
SELDOM_SHARE = 0.5  # measured in fewer frames than this, a pixel is usually out of range
MOVED_MAX_SHARE = 350 / (320 * 240)

_SCENE = "scene.json"
_PREVIEW = "preview.png"
_PREVIEW_COLUMNS = 5
_BESIDE = np.ones((3, 3), dtype=np.uint8)

Mask = npt.NDArray[np.uint8]


class _Stored(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    viewpoint: str
    recorded_at_ms: int
    frames: list[str]  # SHA-256 of each PNG, in order
    approved_by: str = ""
    approved_at_ms: int = 0
    expires_at_ms: int = 0
    approved_digest: str = ""


@dataclass(frozen=True, slots=True)
class EmptyScene:
    """A viewpoint's bank; Unix ms; 0 or empty until approved."""

    viewpoint: str
    folder: Path
    recorded_at_ms: int
    frame_count: int
    approved_by: str
    approved_at_ms: int
    expires_at_ms: int
    approved_digest: str
    digest: str

    @property
    def preview(self) -> Path:
        """Picture for approval: published frames, largest change."""
        return self.folder / _PREVIEW

    def state(self, now_ms: int) -> str:
        """Return `recorded`, `changed` (since approval), `expired` or `approved`."""
        if not self.approved_by:
            return "recorded"
        if self.approved_digest != self.digest:
            return "changed"
        return "expired" if now_ms >= self.expires_at_ms else "approved"


def record_scene(robot: Path, viewpoint: str, frames: Sequence[Depth], now_ms: int) -> EmptyScene:
    """Unapproved. Raises BACKGROUND_INVALID (name, number, motion), FILE_EXISTS for a linked folder."""
    folder = _folder(robot, viewpoint)
    if len(frames) < FRAMES_MIN_COUNT:
        raise BlockRobotError("BACKGROUND_INVALID", f"There are {len(frames)} frames; {FRAMES_MIN_COUNT} are needed.")
    step = max(1, len(frames) // FRAMES_MAX_COUNT)
    chosen = [check_depth(frame, shape=frames[0].shape[:2]) for frame in frames[::step][:FRAMES_MAX_COUNT]]
    check_empty(chosen)
    pngs = [frame.png for frame in empty_bank(chosen)]
    require_own_folder(folder)
    for old in folder.glob(NUMBERED_PICTURES):
        old.unlink()
    for number, png in enumerate(pngs):
        write_private(folder / f"{number:03d}.png", png)
    write_private(folder / _PREVIEW, _preview(chosen))
    _write(folder, _Stored(viewpoint, now_ms, [hashlib.sha256(png).hexdigest() for png in pngs]))
    return get_scene(robot, viewpoint)


def list_scenes(robot: Path) -> list[EmptyScene]:
    found = sorted((robot / FOLDER).glob(f"*/{_SCENE}"))
    return [get_scene(robot, path.parent.name) for path in found]


def get_scene(robot: Path, viewpoint: str) -> EmptyScene:
    """Raises BACKGROUND_NOT_FOUND, BACKGROUND_INVALID."""
    folder = _folder(robot, viewpoint)
    stored = _read(folder)
    return EmptyScene(
        viewpoint=viewpoint,
        folder=folder,
        recorded_at_ms=stored.recorded_at_ms,
        frame_count=len(stored.frames),
        approved_by=stored.approved_by,
        approved_at_ms=stored.approved_at_ms,
        expires_at_ms=stored.expires_at_ms,
        approved_digest=stored.approved_digest,
        digest=_digest(stored, _pngs(folder, stored)),
    )


def approve_scene(robot: Path, viewpoint: str, *, by: str, days: int, now_ms: int) -> EmptyScene:
    """For `days`. Raises BACKGROUND_*."""
    if not by.strip() or not 1 <= days <= VALID_MAX_DAYS:
        raise BlockRobotError("BACKGROUND_INVALID", f"An approval names a person and 1 to {VALID_MAX_DAYS} days.")
    scene = get_scene(robot, viewpoint)
    stored = msgspec.structs.replace(
        _read(scene.folder),
        approved_by=by.strip(),
        approved_at_ms=now_ms,
        expires_at_ms=now_ms + days * DAY_MS,
        approved_digest=scene.digest,
    )
    _write(scene.folder, stored)
    return replace(
        scene,
        approved_by=stored.approved_by,
        approved_at_ms=now_ms,
        expires_at_ms=stored.expires_at_ms,
        approved_digest=scene.digest,
    )


def approved_scene(robot: Path, viewpoint: str, now_ms: int) -> EmptyScene:
    """Raises BACKGROUND_NOT_FOUND, _NOT_APPROVED, _EXPIRED, _INVALID."""
    scene = get_scene(robot, viewpoint)
    state = scene.state(now_ms)
    if state == "expired":
        raise BlockRobotError(
            "BACKGROUND_EXPIRED", f"The empty frames of {viewpoint} were approved for a time now over."
        )
    if state != "approved":
        sentence = "have not been approved" if state == "recorded" else "are not those that were approved"
        raise BlockRobotError("BACKGROUND_NOT_APPROVED", f"The empty frames of {viewpoint} {sentence}.")
    return scene


def approved_frames(robot: Path, viewpoint: str, now_ms: int) -> list[Depth]:
    """Raises as `approved_scene`."""
    scene = approved_scene(robot, viewpoint, now_ms)
    pngs = _pngs(scene.folder, _read(scene.folder))
    return [decode_depth_png(png) for png in pngs]


def published_frames(frames: Sequence[Depth]) -> list[Depth]:
    """Evenly spread, as in the preview."""
    count = min(PUBLISHED_MAX_COUNT, len(frames))
    return [frames[number * len(frames) // count] for number in range(count)]


def check_empty(frames: Sequence[Depth]) -> None:
    """Raise BACKGROUND_INVALID on motion; still people go undetected."""
    changed = _most_changed(frames)[1]
    if _largest_px(changed) > MOVED_MAX_SHARE * changed.size:
        detail = f"Something moved in {4 * _largest_px(changed)} pixels: the scene was not empty."
        raise BlockRobotError("BACKGROUND_INVALID", detail)


def moved_px(frames: Sequence[Depth]) -> int:
    """Return the largest half-resolution blob that differs from the median."""
    return _largest_px(_most_changed(frames)[1])


def _most_changed(frames: Sequence[Depth]) -> tuple[int, Mask]:
    """Return frame number and half-resolution mask; seldom measured pixels count."""
    halves = np.stack([frame[::2, ::2] for frame in frames])
    measured = np.count_nonzero(halves, axis=0)
    usual = np.take_along_axis(np.sort(halves, axis=0), (len(frames) - 1 - measured // 2)[None], axis=0)[0]
    seldom = measured < SELDOM_SHARE * len(frames)
    usual[seldom] = 0
    # Edges waver by a pixel, so a pixel may be as near or far as what is usual beside it.
    near = cv2.erode(np.where(usual > 0, usual, np.uint16(65_535)), _BESIDE).astype(np.float32)
    far = cv2.dilate(usual, _BESIDE).astype(np.float32)
    low, high = near - np.maximum(MOVED_MIN_MM, MOVED_SHARE * near), far + np.maximum(MOVED_MIN_MM, MOVED_SHARE * far)
    worst: tuple[int, Mask] = (0, np.zeros(halves.shape[1:], dtype=np.uint8))
    for number, half in enumerate(halves):
        differs = (half > 0) & (usual > 0) & ((half < low) | (half > high))
        appeared = cv2.morphologyEx(((half > 0) & seldom).view(np.uint8), cv2.MORPH_OPEN, _BESIDE)
        changed = np.asarray(differs | (np.asarray(appeared) > 0), dtype=np.uint8)
        if number == 0 or _largest_px(changed) > _largest_px(worst[1]):
            worst = (number, changed)
    return worst


def _largest_px(changed: Mask) -> int:
    count, _, stats, _ = cv2.connectedComponentsWithStats(changed, connectivity=8)
    return int(np.asarray(stats)[1:, cv2.CC_STAT_AREA].max()) if count > 1 else 0


def _preview(frames: Sequence[Depth]) -> bytes:
    number, changed = _most_changed(frames)
    height, width = frames[0].shape
    where = np.asarray(cv2.resize(changed, (width, height), interpolation=cv2.INTER_NEAREST)) > 0
    shown = [*published_frames(frames), frames[number], np.where(where, frames[number], np.uint16(0))]
    shown += [np.zeros_like(frames[0])] * (-len(shown) % _PREVIEW_COLUMNS)
    rows = [np.hstack(shown[i : i + _PREVIEW_COLUMNS]) for i in range(0, len(shown), _PREVIEW_COLUMNS)]
    return colourise(np.ascontiguousarray(np.vstack(rows)))


def _folder(robot: Path, viewpoint: str) -> Path:
    plain = viewpoint.replace("-", "").replace("_", "")
    if not (plain.isascii() and plain.isalnum()) or len(viewpoint) > NAME_MAX_CHARS:
        raise BlockRobotError("USAGE_INVALID", "A viewpoint's name has letters, digits, - and _ only.")
    return robot / FOLDER / viewpoint


def _read(folder: Path) -> _Stored:
    try:
        return read_json_as((folder / _SCENE).read_bytes(), _Stored)
    except FileNotFoundError:
        raise BlockRobotError("BACKGROUND_NOT_FOUND", f"There are no empty frames of {folder.name}.") from None
    except (OSError, TextInvalidError) as error:
        raise BlockRobotError("BACKGROUND_INVALID", f"The empty frames of {folder.name} cannot be read.") from error


def _write(folder: Path, stored: _Stored) -> None:
    temporary = folder / f".{_SCENE}.tmp"
    write_private(temporary, msgspec.json.format(msgspec.json.encode(stored), indent=2))
    temporary.replace(folder / _SCENE)


def _pngs(folder: Path, stored: _Stored) -> list[bytes]:
    try:
        return [(folder / f"{number:03d}.png").read_bytes() for number in range(len(stored.frames))]
    except OSError as error:
        raise BlockRobotError("BACKGROUND_INVALID", f"An empty frame of {folder.name} is gone.") from error


def _digest(stored: _Stored, pngs: Sequence[bytes]) -> str:
    parts = [stored.viewpoint.encode(), *(hashlib.sha256(png).digest() for png in pngs)]
    return hashlib.sha256(b"\n".join(parts)).hexdigest()

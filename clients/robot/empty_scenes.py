"""Banks of empty frames, one for each viewpoint of a robot: recorded, looked at and approved by a person, expiring.

What is in a bank is shown in every rendition, so nobody may be in it. A bank must never be used unapproved, changed
after its approval, or after its time.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import msgspec
import numpy as np

from clients.robot.events import Depth, check_depth
from clients.robot.hiding.background import empty_bank
from clients.sdk.picture import colourise, decode_depth_png
from consensus.errors import BlockRobotError

FOLDER = "empty-scenes"
FRAMES_MIN_COUNT = 8
FRAMES_MAX_COUNT = 45
VALID_DEFAULT_DAYS = 30
VALID_MAX_DAYS = 365
NAME_MAX_CHARS = 40
DAY_MS = 24 * 60 * 60 * 1000
# Something moved where a pixel's depth at the beginning and at the end differ by this much, over an area like a hand's.
MOVED_MIN_MM = 150
MOVED_SHARE = 0.05
MOVED_MAX_PX = 350  # at half resolution: about a head at 5 m

_SCENE = "scene.json"
_PREVIEW = "preview.png"


class _Stored(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The bank's file: what was recorded, and who approved exactly that."""

    viewpoint: str
    recorded_at_ms: int
    frames: list[str]  # SHA-256 of each PNG, in order
    approved_by: str = ""
    approved_at_ms: int = 0
    expires_at_ms: int = 0
    approved_digest: str = ""


@dataclass(frozen=True, slots=True)
class EmptyScene:
    """A viewpoint's bank as it stands. Times in milliseconds since 1970; empty or 0 where not approved yet."""

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
        """The picture that a person looks at before approving: first, middle and last frame, and what changed."""
        return self.folder / _PREVIEW

    def state(self, now_ms: int) -> str:
        """Return `recorded`, `changed` (since it was approved), `expired` or `approved`."""
        if not self.approved_by:
            return "recorded"
        if self.approved_digest != self.digest:
            return "changed"
        return "expired" if now_ms >= self.expires_at_ms else "approved"


def record_scene(robot: Path, viewpoint: str, frames: Sequence[Depth], now_ms: int) -> EmptyScene:
    """Store empty frames as a viewpoint's bank, in place of an older one, unapproved.

    Raises BACKGROUND_INVALID for a bad name, too few frames, or frames in which something moves.
    """
    folder = _folder(robot, viewpoint)
    if len(frames) < FRAMES_MIN_COUNT:
        raise BlockRobotError("BACKGROUND_INVALID", f"There are {len(frames)} frames; {FRAMES_MIN_COUNT} are needed.")
    step = max(1, len(frames) // FRAMES_MAX_COUNT)
    chosen = [check_depth(frame, shape=frames[0].shape[:2]) for frame in frames[::step][:FRAMES_MAX_COUNT]]
    moved = moved_px(chosen)
    if moved > MOVED_MAX_PX:
        raise BlockRobotError("BACKGROUND_INVALID", f"Something moved in {4 * moved} pixels: the scene was not empty.")
    pngs = [frame.png for frame in empty_bank(chosen)]
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    for old in folder.glob("*.png"):
        old.unlink()
    for number, png in enumerate(pngs):
        (folder / f"{number:03d}.png").write_bytes(png)
    (folder / _PREVIEW).write_bytes(_preview(chosen))
    _write(folder, _Stored(viewpoint, now_ms, [hashlib.sha256(png).hexdigest() for png in pngs]))
    return find_scene(robot, viewpoint)


def list_scenes(robot: Path) -> list[EmptyScene]:
    """Return all banks of a robot by name."""
    found = sorted((robot / FOLDER).glob(f"*/{_SCENE}"))
    return [find_scene(robot, path.parent.name) for path in found]


def find_scene(robot: Path, viewpoint: str) -> EmptyScene:
    """Return a viewpoint's bank. Raises BACKGROUND_NOT_FOUND, BACKGROUND_INVALID."""
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
    """Note that a person has looked at the bank and saw nobody; good for `days`. Raises BACKGROUND_*."""
    if not by.strip() or not 1 <= days <= VALID_MAX_DAYS:
        raise BlockRobotError("BACKGROUND_INVALID", f"An approval names a person and 1 to {VALID_MAX_DAYS} days.")
    scene = find_scene(robot, viewpoint)
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


def approved_frames(robot: Path, viewpoint: str, now_ms: int) -> list[Depth]:
    """Return the frames of an approved bank. Raises BACKGROUND_NOT_FOUND, _NOT_APPROVED, _EXPIRED, _INVALID."""
    scene = find_scene(robot, viewpoint)
    state = scene.state(now_ms)
    if state == "expired":
        raise BlockRobotError(
            "BACKGROUND_EXPIRED", f"The empty frames of {viewpoint} were approved for a time now over."
        )
    if state != "approved":
        sentence = "have not been approved" if state == "recorded" else "are not those that were approved"
        raise BlockRobotError("BACKGROUND_NOT_APPROVED", f"The empty frames of {viewpoint} {sentence}.")
    pngs = _pngs(scene.folder, _read(scene.folder))
    return [decode_depth_png(png) for png in pngs]


def moved_px(frames: Sequence[Depth]) -> int:
    """Return how many half-resolution pixels changed between the first and the last third: the largest such piece."""
    third = max(1, len(frames) // 3)
    first, last = (
        np.median(np.stack([f[::2, ::2] for f in part]), axis=0) for part in (frames[:third], frames[-third:])
    )
    difference = np.abs(first - last)
    changed = (first > 0) & (last > 0) & (difference > np.maximum(MOVED_MIN_MM, MOVED_SHARE * np.minimum(first, last)))
    count, _, stats, _ = cv2.connectedComponentsWithStats(changed.astype(np.uint8), connectivity=8)
    return int(np.asarray(stats)[1:, cv2.CC_STAT_AREA].max()) if count > 1 else 0


def _preview(frames: Sequence[Depth]) -> bytes:
    shown = np.hstack([frames[0], frames[len(frames) // 2], frames[-1]])
    return colourise(shown)


def _folder(robot: Path, viewpoint: str) -> Path:
    plain = viewpoint.replace("-", "").replace("_", "")
    if not (plain.isascii() and plain.isalnum()) or len(viewpoint) > NAME_MAX_CHARS:
        raise BlockRobotError("BACKGROUND_INVALID", "A viewpoint's name has letters, digits, - and _ only.")
    return robot / FOLDER / viewpoint


def _read(folder: Path) -> _Stored:
    try:
        return msgspec.json.decode((folder / _SCENE).read_bytes(), type=_Stored)
    except FileNotFoundError:
        raise BlockRobotError("BACKGROUND_NOT_FOUND", f"There are no empty frames of {folder.name}.") from None
    except (OSError, msgspec.DecodeError) as error:
        raise BlockRobotError("BACKGROUND_INVALID", f"The empty frames of {folder.name} cannot be read.") from error


def _write(folder: Path, stored: _Stored) -> None:
    temporary = folder / f".{_SCENE}.tmp"
    temporary.write_bytes(msgspec.json.format(msgspec.json.encode(stored), indent=2))
    temporary.replace(folder / _SCENE)


def _pngs(folder: Path, stored: _Stored) -> list[bytes]:
    try:
        return [(folder / f"{number:03d}.png").read_bytes() for number in range(len(stored.frames))]
    except OSError as error:
        raise BlockRobotError("BACKGROUND_INVALID", f"An empty frame of {folder.name} is gone.") from error


def _digest(stored: _Stored, pngs: Sequence[bytes]) -> str:
    """Return what an approval is of: the viewpoint and every frame as it is now."""
    parts = [stored.viewpoint.encode(), *(hashlib.sha256(png).digest() for png in pngs)]
    return hashlib.sha256(b"\n".join(parts)).hexdigest()

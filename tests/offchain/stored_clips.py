"""Clips of random bytes as rows of a store, and the pieces by which they are found in its files."""

from __future__ import annotations

import random
import secrets
from pathlib import Path

from consensus.primitives.hashing import sha256
from node.custody.stores.custody_store import ClipRow, FrameRow
from node.custody.stores.sqlite_store import DATABASE_FILE_NAME

FRAMES_COUNT = 4
FRAME_BYTES = 9_000


def make_clip(
    number: int, frame_bytes: int = FRAME_BYTES, frames: int = FRAMES_COUNT, dice: random.Random | None = None
) -> tuple[ClipRow, list[FrameRow]]:
    draw = secrets.token_bytes if dice is None else dice.randbytes
    record_id = draw(16)
    leaves = tuple(sha256(record_id + bytes([index])) for index in range(frames))
    clip = ClipRow(record_id, draw(32), 1000, "staged", leaves, tuple(map(sha256, leaves)))
    rows = [FrameRow(record_id, index, draw(frame_bytes), draw(136), 1000 * number + index) for index in range(frames)]
    return clip, rows


def pieces_of(clip: ClipRow, frames: list[FrameRow]) -> list[bytes]:
    leaves = [leaf[:16] for leaf in (*clip.commitment_leaves, *clip.ciphertext_leaves)]
    keys = [frame.wrapped_key[start : start + 16] for frame in frames for start in (0, 60, 120)]
    texts = [
        frame.ciphertext[start : start + 16]
        for frame in frames
        for start in range(0, max(1, len(frame.ciphertext) - 16), 400)
    ]
    return [*leaves, *keys, *texts]


def bytes_in(folder: Path) -> bytes:
    return b"".join(path.read_bytes() for path in folder.glob(f"{DATABASE_FILE_NAME}*"))

"""Wraps frames under erase keys, which are wiped after use."""

from __future__ import annotations

from collections.abc import Sequence

from consensus.records.clips import FrameDownload
from node.custody.erase_keys import wrap_key
from node.custody.stores.custody_store import FrameRow
from node.process_memory import wipe


def parts_of(frames: Sequence[FrameDownload]) -> list[tuple[int, bytes, bytes]]:
    return [(frame.index, frame.ciphertext, frame.sealed_key) for frame in frames]


def wrap_frames(
    record_id: bytes, frames: Sequence[tuple[int, bytes, bytes]], taken: Sequence[tuple[int, bytes]]
) -> list[FrameRow]:
    return [
        FrameRow(record_id, index, text, wrap_key(erase_key, record_id, index, key), slot)
        for (index, text, key), (slot, erase_key) in zip(frames, taken, strict=True)
    ]


def wipe_keys(taken: Sequence[tuple[int, bytes]]) -> None:
    for _, erase_key in taken:
        wipe(erase_key)

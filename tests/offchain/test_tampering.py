"""The demonstration's tampering reaches the bytes that each store really keeps."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest

from network.demo.tampering import flip_stored_byte
from node.custody.stores.custody_store import ClipRow, FrameRow
from node.custody.stores.open_store import open_store

RECORD_ID, LEAF = b"\x01" * 16, b"\x03" * 32


@dataclass
class Configured:
    """As much of a node's configuration as says where its store is."""

    custody_store: str
    custody_dir: Path


@pytest.mark.parametrize("kind", ["sqlite", "mongo"])
async def test_one_bit_of_one_frame_is_changed(kind: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    uri = "sqlite" if kind == "sqlite" else request.getfixturevalue("mongo_database")
    frames = [FrameRow(RECORD_ID, index, bytes([index]) * 100, b"wrapped", index) for index in range(3)]
    async with open_store(uri, tmp_path) as store:
        await store.stage(ClipRow(RECORD_ID, LEAF, 1000, "staged", (LEAF,) * 3, (LEAF,) * 3), frames)
        flip_stored_byte(Configured(uri, tmp_path), RECORD_ID, 1)  # type: ignore[arg-type]
        found = await store.frames(RECORD_ID)
    assert [found[0], found[2]] == [frames[0], frames[2]]
    different = [(was ^ now) for was, now in zip(frames[1].ciphertext, found[1].ciphertext, strict=True) if was != now]
    assert different == [1]

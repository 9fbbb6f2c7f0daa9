"""Peers with small snapshots, and no waiting."""

from __future__ import annotations

from pathlib import Path

import pytest

from node.snapshot import fetching, joining, making, snapshot_format
from tests.unit.node.snapshot.snapshot_peers import Peers


@pytest.fixture
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(making, "CHUNK_SIZE_BYTES", 600)
    monkeypatch.setattr(snapshot_format, "CHUNK_SIZE_MEAN_MIN_BYTES", 600 // 8)


@pytest.fixture
async def peers(tmp_path: Path, small_chunks: None, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(fetching, "OFFER_RETRY_MS", 50)
    monkeypatch.setattr(joining, "RETRY_MS", 1)
    made = Peers(tmp_path / "peers")
    yield made
    await made.stop()

"""The worlds that the wallet's tests share."""

from __future__ import annotations

from pathlib import Path

import pytest

from clients.wallet.ledger.wallet import Wallet
from tests.world.commands import People
from tests.world.dicts import World
from tests.world.sharing import SharedWard
from tests.world.transcripts import Transcript


@pytest.fixture
def world(tmp_path: Path) -> World:
    return World(tmp_path)


@pytest.fixture
def ward(tmp_path: Path) -> SharedWard:
    return SharedWard(tmp_path)


@pytest.fixture
def doctor(ward: SharedWard) -> Wallet:
    return ward.come_in("doctor", "staff")


@pytest.fixture
def people(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> People:
    return People(tmp_path, monkeypatch)


@pytest.fixture
def transcript(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Transcript:
    """An empty transcript. Lines are as long as they are: no terminal breaks them."""
    monkeypatch.setenv("COLUMNS", "1000")
    return Transcript(tmp_path)

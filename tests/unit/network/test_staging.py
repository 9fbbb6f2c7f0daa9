"""What stages leave on disk when a command fails."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from consensus.errors import BlockRobotError
from network.testbed import Stage


def test_a_tags_uid_does_not_stay_on_disk_where_no_card_was_issued(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage = Stage(tmp_path, store="sqlite", base_port=1, purpose="demo")
    stage.wallets.mkdir()
    nowhere = ["--registrar-dir", str(tmp_path / "no-registrar"), "--genesis", str(tmp_path / "no-genesis.json")]
    monkeypatch.setattr(Stage, "registrar_arguments", lambda _: nowhere)
    with pytest.raises(BlockRobotError):
        asyncio.run(stage.issue_card("subject", "patient-a", "E2" * 12))
    assert list(stage.wallets.iterdir()) == []

"""Two programs on one wallet: the second is told, and nothing that the first noted is lost."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import pytest

from clients.wallet.claiming import claim_wallet
from consensus.errors import BlockRobotError


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "ann.wallet"
    path.write_bytes(b"sealed")
    return path


def test_a_second_program_hears_that_the_wallet_is_in_use(file: Path) -> None:
    waited: list[float] = []
    with (
        claim_wallet(file),
        pytest.raises(BlockRobotError, match="WALLET_BUSY"),
        claim_wallet(file, wait_s=1.0, sleep=waited.append),
    ):
        pass
    assert sum(waited) == pytest.approx(1.0)


def test_it_waits_for_a_command_that_is_over_in_a_moment(file: Path) -> None:
    first = ExitStack()
    first.enter_context(claim_wallet(file))
    with (
        claim_wallet(file, sleep=lambda _: first.close()),
        pytest.raises(BlockRobotError, match="WALLET_BUSY"),
        claim_wallet(file, wait_s=0, sleep=lambda _: None),
    ):
        pass


def test_one_after_the_other_is_no_trouble_and_the_lock_is_private(file: Path) -> None:
    for _ in range(2):
        with claim_wallet(file):
            pass
    (lock,) = [path for path in file.parent.iterdir() if path != file]
    assert lock.stat().st_mode & 0o777 == 0o600


def test_where_there_is_no_wallet_nothing_is_made(tmp_path: Path) -> None:
    with pytest.raises(BlockRobotError, match="WALLET_NOT_FOUND"), claim_wallet(tmp_path / "nobody.wallet"):
        pass
    assert list(tmp_path.iterdir()) == []

"""Two programs on one wallet: the second is told, and nothing that the first noted is lost."""

from __future__ import annotations

import fcntl
import os
import re
from contextlib import ExitStack
from pathlib import Path

import click
import pytest

from clients.wallet.store.wallet_lock import claim_place, claim_wallet, lock_or_read_only
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


def test_a_place_is_held_while_its_wallet_is_made_and_the_second_maker_waits_for_nothing(tmp_path: Path) -> None:
    path = tmp_path / "wallets" / "new.wallet"
    with claim_place(path), pytest.raises(BlockRobotError, match="WALLET_BUSY"), claim_place(path):
        pass
    assert list(path.parent.iterdir()) == [], "no wallet came to be"


def test_where_a_wallet_is_none_is_made(file: Path) -> None:
    with pytest.raises(BlockRobotError, match="WALLET_EXISTS"), claim_place(file):
        pass
    assert file.read_bytes() == b"sealed"


def test_a_lock_file_that_is_removed_before_it_is_locked_keeps_the_next_one_out(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lock_it = fcntl.flock
    removed: list[Path] = []

    def lock_late(descriptor: int, how: int) -> None:
        if not removed:
            removed.append(file.with_name(".ann.wallet.lock"))
            removed[0].unlink()
        lock_it(descriptor, how)

    monkeypatch.setattr(fcntl, "flock", lock_late)
    with (
        claim_wallet(file, sleep=lambda _: None),
        pytest.raises(BlockRobotError, match="WALLET_BUSY"),
        claim_wallet(file, wait_s=0, sleep=lambda _: None),
    ):
        pass
    assert removed


def test_who_is_refused_hears_which_command_has_the_wallet_and_since_when(file: Path) -> None:
    with click.Context(click.Command("share"), info_name="blockrobot wallet share"), claim_wallet(file):
        for _ in range(2):
            with pytest.raises(BlockRobotError) as busy, claim_wallet(file, wait_s=0, sleep=lambda _: None):
                pass
            told = (
                rf"`blockrobot wallet share` \(process {os.getpid()}\) has .*ann.wallet open since \d{{4}}-\d\d-\d\d "
            )
            assert re.match(told, busy.value.detail)


def test_whoever_finds_a_page_open_hears_how_to_get_to_it(file: Path) -> None:
    with (
        click.Context(click.Command("serve"), info_name="blockrobot wallet serve"),
        claim_wallet(file),
        pytest.raises(BlockRobotError) as busy,
        claim_wallet(file, wait_s=0, sleep=lambda _: None),
    ):
        pass
    assert "`blockrobot wallet serve`" in busy.value.detail
    assert "press Enter in the terminal where it runs for a new link" in busy.value.next_step


@pytest.mark.parametrize(
    "note", [b"", b"{", b"\xff" * 2000, b'{"command": "x", "process": 1, "since_ms": 99999999999999999}']
)
def test_a_note_that_nobody_understands_only_costs_the_name(file: Path, note: bytes) -> None:
    with claim_wallet(file):
        file.with_name(".ann.wallet.lock").write_bytes(note)
        with (
            pytest.raises(BlockRobotError, match="Another program has"),
            claim_wallet(file, wait_s=0, sleep=lambda _: None),
        ):
            pass


def test_who_only_reads_goes_on_beside_and_is_told(file: Path) -> None:
    waited: list[float] = []
    with claim_wallet(file), lock_or_read_only(file, sleep=waited.append) as busy:
        assert busy is not None
        assert busy.code == "WALLET_BUSY"
    assert sum(waited) <= 0.5
    with lock_or_read_only(file) as free:
        assert free is None
        with lock_or_read_only(file, wait_s=0, sleep=lambda _: None) as second:
            assert second is not None

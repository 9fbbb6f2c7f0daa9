"""Where a user's networks, wallets and robots lie."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from clients.sdk.terminal.terminal import home_folder


def test_a_folder_that_is_named_goes_before_the_platforms_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BLOCKROBOT_HOME", str(tmp_path / "mine"))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    assert home_folder() == tmp_path / "mine"
    monkeypatch.delenv("BLOCKROBOT_HOME")
    assert home_folder() == tmp_path / "data" / "blockrobot"


@pytest.mark.parametrize("relative", ["data", "./data", ""])
def test_a_place_for_data_that_is_not_absolute_is_passed_over(
    relative: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The XDG specification wants it so: it would be another place in each folder."""
    monkeypatch.delenv("BLOCKROBOT_HOME", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("XDG_DATA_HOME", relative)
    monkeypatch.chdir(tmp_path)
    own = ("Library", "Application Support") if sys.platform == "darwin" else (".local", "share")
    assert home_folder() == tmp_path.joinpath(*own, "blockrobot")


def test_a_command_makes_a_wallet_in_the_users_place_for_data(tmp_path: Path) -> None:
    passphrase = tmp_path / "passphrase"
    passphrase.write_text("violet kettle orbit sandwich\n", encoding="utf-8")
    environment = {"HOME": str(tmp_path), "PATH": os.defpath, "BLOCKROBOT_PASSPHRASE_FILE": str(passphrase)}
    command = [Path(sys.executable).with_name("blockrobot"), "wallet", "new", "--words-file", "words.txt"]
    made = subprocess.run(
        [*command, "--fast-passphrase"], env=environment, cwd=tmp_path, capture_output=True, check=False
    )
    assert made.returncode == 0, made.stderr
    assert (tmp_path / ".local" / "share" / "blockrobot" / "wallets" / "default.wallet").is_file()

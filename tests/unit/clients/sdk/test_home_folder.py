"""Where a user's networks, wallets and robots lie, as the XDG base directories have it; and that nobody loses a wallet."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from clients.sdk.terminal.terminal import home_folder


@pytest.fixture
def user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A user of Linux with an empty home directory and none of the variables that name folders."""
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("BLOCKROBOT_HOME", "XDG_DATA_HOME", "XDG_CONFIG_HOME"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path


def make_wallet(home: Path) -> None:
    (home / "wallets").mkdir(parents=True)
    (home / "wallets" / "default.wallet").write_bytes(b"sealed")


def test_data_lies_in_the_users_place_for_data(user: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(user / "settings"))
    assert home_folder() == user / ".local" / "share" / "blockrobot"


def test_data_lies_where_xdg_data_home_says(user: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", str(user / "data"))
    assert home_folder() == user / "data" / "blockrobot"


@pytest.mark.parametrize("wrong", ["", "data", "./data"])
def test_a_place_that_is_not_absolute_is_ignored(user: Path, monkeypatch: pytest.MonkeyPatch, wrong: str) -> None:
    monkeypatch.setenv("XDG_DATA_HOME", wrong)
    assert home_folder() == user / ".local" / "share" / "blockrobot"


@pytest.mark.parametrize("settings", [None, "settings"])
@pytest.mark.parametrize("kept", ["network", "wallets", "robots"])
def test_what_lies_in_the_former_place_goes_on_being_used(
    user: Path, monkeypatch: pytest.MonkeyPatch, settings: str | None, kept: str
) -> None:
    former = user / (settings or ".config") / "blockrobot"
    if settings:
        monkeypatch.setenv("XDG_CONFIG_HOME", str(former.parent))
    (former / kept).mkdir(parents=True)
    assert home_folder() == former


def test_a_cache_in_the_new_place_hides_no_wallet_in_the_former_one(user: Path) -> None:
    former, present = user / ".config" / "blockrobot", user / ".local" / "share" / "blockrobot"
    make_wallet(former)
    (present / "recordings").mkdir(parents=True)
    assert home_folder() == former


def test_a_cache_in_the_former_place_is_no_reason_to_stay_there(user: Path) -> None:
    (user / ".config" / "blockrobot" / "recordings").mkdir(parents=True)
    assert home_folder() == user / ".local" / "share" / "blockrobot"


def test_who_has_both_places_uses_the_new_one(user: Path) -> None:
    former, present = user / ".config" / "blockrobot", user / ".local" / "share" / "blockrobot"
    make_wallet(former)
    make_wallet(present)
    assert home_folder() == present


def test_a_folder_that_is_named_goes_before_all_others(user: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    make_wallet(user / ".config" / "blockrobot")
    monkeypatch.setenv("BLOCKROBOT_HOME", str(user / "mine"))
    monkeypatch.setenv("XDG_DATA_HOME", str(user / "data"))
    assert home_folder() == user / "mine"


@pytest.mark.parametrize(
    ("variable", "left"), [("XDG_CONFIG_HOME", ".local/share"), ("XDG_DATA_HOME", ".config")], ids=["former", "new"]
)
def test_a_place_that_the_system_refuses_to_look_at_is_one_without_a_wallet(
    user: Path, monkeypatch: pytest.MonkeyPatch, variable: str, left: str
) -> None:
    monkeypatch.setenv(variable, str(user / ("too long for a name" * 20)))
    make_wallet(user / left / "blockrobot")
    assert home_folder() == user / left / "blockrobot"


def test_macos_keeps_its_own_place(user: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "darwin")
    monkeypatch.setenv("XDG_DATA_HOME", str(user / "data"))
    assert home_folder() == user / "Library" / "Application Support" / "blockrobot"


def test_a_command_finds_the_wallet_that_an_earlier_version_made(tmp_path: Path) -> None:
    """The real command, in a process of its own: it knows of the old wallet, and makes nothing in the new place."""
    environment = {"HOME": str(tmp_path), "PATH": os.defpath, "BLOCKROBOT_LANGUAGE": "en", "LANG": "C.UTF-8"}

    def type_new(words: str) -> subprocess.CompletedProcess[str]:
        command = [str(Path(sys.executable).with_name("blockrobot")), "wallet", "new", "--words-file", words]
        passphrase = tmp_path / "passphrase"
        passphrase.write_text("four plain words here\n", encoding="utf-8")
        named = {**environment, "BLOCKROBOT_PASSPHRASE_FILE": str(passphrase)}
        command += ["--fast-passphrase"]
        return subprocess.run(command, env=named, cwd=tmp_path, capture_output=True, text=True, check=False)

    make_wallet(tmp_path / ".config" / "blockrobot")
    refused = type_new("words.txt")
    assert refused.returncode != 0
    assert str(tmp_path / ".config" / "blockrobot" / "wallets" / "default.wallet") in refused.stderr
    assert not (tmp_path / ".local").exists()

    (tmp_path / ".config" / "blockrobot").rename(tmp_path / "elsewhere")
    made = type_new("words.txt")
    assert made.returncode == 0, made.stderr
    assert (tmp_path / ".local" / "share" / "blockrobot" / "wallets" / "default.wallet").is_file()

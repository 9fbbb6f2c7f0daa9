"""What a shell completes, and the script that makes it."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.shell_completion import ShellComplete
from click.testing import CliRunner

from clients.sdk.terminal.lazy_group import LazyGroup
from network.cli.main import main


def completed(*arguments: str, incomplete: str = "") -> list[str]:
    asked = ShellComplete(main, {}, "blockrobot", "_BLOCKROBOT_COMPLETE")
    return [item.value for item in asked.get_completions(list(arguments), incomplete)]


@pytest.mark.parametrize("shell", ["bash", "fish", "zsh"])
def test_a_shell_gets_its_script(shell: str) -> None:
    done = CliRunner().invoke(main, ["completion", shell])
    assert done.exit_code == 0
    assert f"_BLOCKROBOT_COMPLETE={shell}_complete" in done.output
    assert "%(" not in done.output


def test_commands_options_and_languages_complete_without_importing_any(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "--per-page" in completed("wallet", "records", incomplete="--p")
    assert completed("wallet", incomplete="inb") == ["inbox"]
    assert completed("wallet", "--language", incomplete="p") == ["pt"]
    assert CliRunner().invoke(main, ["completion", "csh"]).exit_code == 2

    def importing(*_: object) -> None:
        raise AssertionError("a command was imported to list its name")

    monkeypatch.setattr(LazyGroup, "get_command", importing)
    assert completed(incomplete="wal") == ["wallet"]
    assert {"up", "wallet", "robot"} <= set(completed())


def test_profiles_and_viewed_records_complete_from_this_machine_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BLOCKROBOT_HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path / "..")
    (tmp_path / "wallets").mkdir()
    for name in ("ann", "anton", "bob"):
        (tmp_path / "wallets" / f"{name}.wallet").touch()
    (tmp_path / "pictures" / ("3fa2c19b07de" + "00" * 10)).mkdir(parents=True)
    assert completed("wallet", "--profile", incomplete="an") == ["ann", "anton"]
    assert completed("wallet", "view", "--out", str(tmp_path / "pictures"), incomplete="3f") == ["3fa2c19b07de"]
    assert completed("wallet", "verify", incomplete="3f") == []

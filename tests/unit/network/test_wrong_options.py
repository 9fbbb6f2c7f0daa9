"""An option that cannot be ends a command with 2, whichever command it is, before anything is asked or done."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from consensus.exit_codes import EXIT_USAGE
from network.cli.main import main


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A home with nothing in it but a passphrase, a genesis file that is none, and files for what has to be there."""
    (tmp_path / "passphrase").write_text("tea and lemon cake\n")
    (tmp_path / "plan.toml").write_text("seed = 1\n")
    monkeypatch.setenv("BLOCKROBOT_HOME", str(tmp_path))
    monkeypatch.setenv("BLOCKROBOT_PASSPHRASE_FILE", str(tmp_path / "passphrase"))
    return tmp_path


@pytest.mark.parametrize(
    "arguments",
    [
        "wallet records --sensor lidar",
        "wallet records --day tomorrow",
        "wallet records --time noon",
        "wallet records --page 0",
        "wallet --profile ../x records",
        "wallet erase --all --yes --frames 1",
        "wallet erase aaaaaaaa bbbbbbbb --yes --frames 1",
        "wallet erase aaaaaaaa --yes --frames one",
        "wallet erase --yes",
        "wallet serve --idle-minutes 0",
        "robot background approve ../x --by Ann --yes",
        "robot background approve ward --by Ann --yes --days 0",
        "sim run --seeds 3..1",
        "sim run --seeds 1..2 --trace",
        "sim run --profile grow --nodes 7",
        "sim run --nodes 4 --byzantine 3",
        "sim run --plan plan.toml --seeds 1",
        "roster make --robot zz --out roster",
    ],
)
def test_a_wrong_option_is_wrong_usage(home: Path, arguments: str) -> None:
    command = [str(home / part) if part == "plan.toml" else part for part in arguments.split()]
    done = CliRunner().invoke(main, command)
    assert done.exit_code == EXIT_USAGE, done.output
    assert "Traceback" not in done.output

"""A command that a robot names can be typed as it stands: with the places and files that it was called with."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from clients.robot.cli import main
from clients.robot.cli.main import robot
from clients.sdk.chain.enrolment import Registration


def run(*arguments: str) -> Result:
    return CliRunner().invoke(robot, list(arguments))


def options_of(folder: Path) -> tuple[str, ...]:
    (folder / "secret").write_text("tea\n", "utf-8")
    places = ("--robot-dir", str(folder / "my robots"), "--genesis", str(folder / "genesis.json"))
    return ("--name", "ward-1", *places, "--passphrase-file", str(folder / "secret"))


def test_the_next_commands_are_of_this_very_robot(tmp_path: Path) -> None:
    options = options_of(tmp_path)
    full = f"blockrobot robot {shlex.join(options)}"
    made = run(*options, "new")
    assert f"Next: {full} register CODE" in made.output
    assert f"Next: {full} background record RECORDING" in run(*options, "background", "list").output
    refused = run(*options, "run", "--source", "ros1")
    assert refused.exit_code == 2
    assert f"{full} background record" in refused.stderr
    nobody = ("--name", "nobody", *options[2:])
    missing = run(*nobody, "register", "BR1-AAAA")
    assert f"Make one with `blockrobot robot {shlex.join(nobody)} new`" in missing.stderr


def test_a_robot_of_the_usual_place_is_called_by_its_short_name(tmp_path: Path) -> None:
    home = {"BLOCKROBOT_HOME": str(tmp_path)}
    assert "Next: blockrobot robot register CODE" in CliRunner(env=home).invoke(robot, ["new"]).output


def test_the_registrar_is_told_no_path_of_the_robots_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    options = options_of(tmp_path)
    run(*options, "new")

    async def registered(*_: object) -> Registration:
        return Registration(member=b"\x02" * 33, txid=b"\x01" * 32)

    monkeypatch.setattr(main, "register_robot", registered)
    monkeypatch.setattr(main, "load_genesis", lambda _: None)
    told = run(*options, "register", "BR1-AAAA").output
    assert "roster make --robot " + 33 * "02" + " --out roster.sealed\n" in told
    assert "put it here as" in told

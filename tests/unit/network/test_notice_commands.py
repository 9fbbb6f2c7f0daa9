"""`blockrobot notice`: written, checked and refused without a network; what needs one is tried on real nodes."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from consensus.records.notices import encode_notice, notice_digest
from network.cli.main import main
from network.cli.notice_commands import read_notice_file
from network.demo_notice import demo_notice, demo_notice_text


def run(*arguments: str) -> Result:
    return CliRunner().invoke(main, ["notice", *arguments])


def test_a_new_notice_is_the_demonstrations_and_is_complete(tmp_path: Path) -> None:
    place = tmp_path / "notice.toml"
    assert "check" in run("new", str(place)).output
    assert read_notice_file(place) == demo_notice()
    checked = json.loads(run("check", str(place), "--json").output)
    assert checked["hash"] == notice_digest(encode_notice(demo_notice())).hex()
    assert checked["bytes"] < 14_000
    assert demo_notice().authority.contact in run("check", str(place)).output


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    place = tmp_path / "notice.toml"
    place.write_text("mine")
    result = run("new", str(place), "--json")
    assert (result.exit_code, json.loads(result.output)["error"]["code"]) == (1, "FILE_UNUSABLE")
    assert place.read_text() == "mine"


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("[authority]", "[authoriti]"),
        ('article = "77"', 'article = "78"'),
        ('code = "care"', 'code = "fun"'),
        ("language = ", "language "),
        ('source = "registrar"', 'source = "nowhere"'),
        ('withdrawal = "', 'more = "x"\nwithdrawal = "'),
    ],
)
def test_a_notice_that_is_not_one_is_named_before_anything_is_sent(tmp_path: Path, old: str, new: str) -> None:
    place = tmp_path / "notice.toml"
    assert old in demo_notice_text()
    place.write_text(demo_notice_text().replace(old, new))
    for command in (("check",), ("publish", "--as", "hospital", "--dir", str(tmp_path))):
        result = run(command[0], str(place), *command[1:], "--json")
        told = json.loads(result.output)["error"]
        assert (result.exit_code, told["code"]) == (1, "NOTICE_INVALID")
        assert told["detail"]


def test_without_a_network_it_is_said(tmp_path: Path) -> None:
    for command in ("show", "activities"):
        result = run(command, "--dir", str(tmp_path), "--json")
        assert (result.exit_code, json.loads(result.output)["error"]["code"]) == (1, "CLUSTER_NOT_RUNNING")

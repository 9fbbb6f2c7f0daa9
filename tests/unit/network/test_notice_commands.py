"""`blockrobot notice`: written, checked and refused without a network; what needs one is tried on real nodes."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner, Result

from consensus.rights.notices import NoticeVersion, PublishedNotice, encode_notice, notice_digest
from network.cli.governance import notice_commands
from network.cli.governance.notice_commands import read_notice_file
from network.cli.main import main
from network.notices.notice_publishing import demo_notice, demo_notice_text


def run(*arguments: str) -> Result:
    return CliRunner().invoke(main, ["notice", *arguments])


def test_a_new_notice_is_complete_and_overwrites_nothing(tmp_path: Path) -> None:
    place = tmp_path / "notice.toml"
    assert "check" in run("new", str(place)).output
    assert read_notice_file(place) == demo_notice()
    checked = json.loads(run("check", str(place), "--json").output)
    assert checked["hash"] == notice_digest(encode_notice(demo_notice())).hex()
    assert checked["bytes"] < 14_000
    assert demo_notice().authority.contact in run("check", str(place)).output
    place.write_text("mine")
    result = run("new", str(place), "--json")
    assert (result.exit_code, json.loads(result.output)["error"]["code"]) == (1, "FILE_EXISTS")
    assert place.read_text() == "mine"


def test_a_file_that_breaks_off_is_named_with_its_last_line(tmp_path: Path) -> None:
    place, lines = tmp_path / "notice.toml", demo_notice_text().splitlines()
    place.write_text("\n".join(lines[:30]) + "\n" + "[third_countries")
    told = json.loads(run("check", str(place), "--json").output)["error"]
    assert (told["code"], "line 31" in told["detail"]) == ("NOTICE_INVALID", True)
    place.write_text("\n".join(lines[:30]) + '\nwords = """half a sen')
    assert "line 31, the last one" in json.loads(run("check", str(place), "--json").output)["error"]["detail"]
    place.write_bytes("\n".join(lines[:4]).encode() + b"\n\xff\xfe\n")
    assert "line 5" in json.loads(run("check", str(place), "--json").output)["error"]["detail"]


def test_publishing_asks_and_shows_what_changes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It stays for ever: without a terminal somebody has to have said yes."""
    place = tmp_path / "notice.toml"
    place.write_text(demo_notice_text())
    refused = run("publish", str(place), "--as", "hospital", "--dir", str(tmp_path))
    assert (refused.exit_code, "--yes" in refused.output) == (2, True)
    asked: list[str] = []
    monkeypatch.setattr(notice_commands, "ask", lambda text, **_: asked.append(text))
    row = NoticeVersion("hospital", 3, bytes(32), 9, 1)
    other = msgspec.structs.replace(demo_notice(), automated_decisions="None, in other words.")
    said: list[str] = []
    monkeypatch.setattr(notice_commands.click, "echo", lambda text, **_: said.append(text))
    notice_commands._ask_to_publish("hospital", PublishedNotice(row, other), demo_notice(), yes=False)
    assert asked == ["Publish it?"]
    assert "- Automated decisions: None, in other words." in said
    assert "version 4" in said[-1]
    notice_commands._ask_to_publish("hospital", PublishedNotice(row, demo_notice()), demo_notice(), yes=False)
    notice_commands._ask_to_publish("hospital", None, demo_notice(), yes=True)
    assert len(asked) == 1
    notice_commands._ask_to_publish("hospital", None, demo_notice(), yes=False)
    assert "version 1" in said[-1]


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

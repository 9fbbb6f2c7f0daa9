"""A demonstration takes a folder again, but for one in which its user has put something since."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from network.cli.main import main
from network.cli.measure import demo_commands


@pytest.fixture(autouse=True)
def runs(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """What each run found in its folder: it leaves some of what a demonstration leaves."""
    found: list[list[str]] = []

    def run(place: Path, *_rest: object, **_named: object) -> None:
        found.append(names(place))
        record = place / "pictures" / "patient-a" / ("0a" * 16)
        record.mkdir(parents=True)
        for file in (record / "picture-0003.frame-00000012.png", place / "patient-b.zip", place / "report.html"):
            file.touch()

    monkeypatch.setattr(demo_commands, "_run", run)
    return found


def names(folder: Path) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if not path.is_dir())


def demo(out: Path) -> Result:
    return CliRunner().invoke(main, ["demo", "--json", "--out", str(out)])


def test_a_demonstration_begins_with_nothing_of_an_earlier_one(tmp_path: Path, runs: list[list[str]]) -> None:
    for _ in range(2):
        assert demo(tmp_path / "demo").exit_code == 0
    assert runs == [[demo_commands.MARK]] * 2


@pytest.mark.parametrize("mine", ["thesis.txt", "photos/a.png", "pictures/patient-a/chosen.png", "network/notes"])
def test_a_file_that_a_user_put_there_since_is_not_deleted(tmp_path: Path, runs: list[list[str]], mine: str) -> None:
    out = tmp_path / "demo"
    demo(out)
    (out / mine).parent.mkdir(parents=True, exist_ok=True)
    (out / mine).write_text("years of work", encoding="utf-8")
    before = names(out)
    error = json.loads(demo(out).stdout)["error"]
    assert (error["code"], str(out / mine) in error["detail"]) == ("FOLDER_NOT_EMPTY", True)
    assert (names(out), len(runs)) == (before, 1)


def test_no_link_is_followed(tmp_path: Path, runs: list[list[str]]) -> None:
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").touch()
    (tmp_path / "link").symlink_to(tmp_path / "mine")
    demo(tmp_path / "demo")
    (tmp_path / "demo" / "robots").symlink_to(tmp_path / "mine")
    for out in (tmp_path / "link", tmp_path / "demo"):
        assert json.loads(demo(out).stdout)["error"]["code"] == "FOLDER_NOT_EMPTY"
    assert (names(tmp_path / "mine"), len(runs)) == (["thesis.txt"], 1)

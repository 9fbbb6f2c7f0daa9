"""The lines for an own recording, typed as they stand, with a recording that no code of ours knows."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cluster.network_under_test import find_base_port
from tests.cluster.own_recording import write_own_recording
from tests.cluster.tutorial_reader import CLONE, Placeholders, Reader
from tests.unit.clients.robot.sources.recordings import storage_file

PLACEHOLDERS = {
    "BR1-...": r"^(BR1-[A-Z2-7-]+)$",
    "MEMBER_KEY": r"blockrobot roster make --robot ([0-9a-f]{66})",
    "ROBOT_FOLDER": r"put it here as (\S+)/roster\.sealed",
}
PAGE, HEADING = "docs/how-to/your-robot.md", "## Every line"
README_HEADING = "## Bring your own robot or recording"


@pytest.fixture
def reader(tmp_path: Path) -> Iterator[Reader]:
    reader = Reader(tmp_path, Placeholders(PLACEHOLDERS), base_port=find_base_port(4))
    yield reader
    reader.close()


def lines_under(page: str, heading: str) -> list[str]:
    section = (CLONE / page).read_text(encoding="utf-8").partition(f"{heading}\n")[2]
    found = re.search(r"```sh\n(.*?)```", section, re.DOTALL)
    assert found
    return found[1].splitlines()


def command_in(line: str) -> str:
    return line.partition("  #")[0].rstrip()


@pytest.mark.smoke
def test_what_the_readme_shows_of_them_are_lines_of_the_page_in_its_order() -> None:
    typed = [command_in(line) for line in lines_under(PAGE, HEADING)]
    shown = [command_in(line) for line in lines_under("README.md", README_HEADING)]
    assert [line for line in typed if line in shown] == shown


@pytest.mark.docs
@pytest.mark.timeout(300)
def test_the_lines_for_an_own_recording_work_as_typed(reader: Reader) -> None:
    ward = reader.home / "ward"
    ward.mkdir()
    storage_file(write_own_recording(ward)).rename(ward / "my-recording.mcap")
    reader.type('export PATH="$PWD/.venv/bin:$PATH" BLOCKROBOT_HOME="$HOME/playground"; cd "$HOME/ward"')
    shown = {}
    for line in lines_under(PAGE, HEADING):
        shown[command_in(line)] = reader.type(line)
        if "--draft" in line:
            check_the_draft(ward / "topics.toml")
    replayed = next(text for line, text in shown.items() if "robot replay" in line)
    assert "120 frames; counted for each owner: 80 kept" in replayed
    assert " 0 lost." in replayed
    assert "80 pictures" in shown["blockrobot wallet records"]


def check_the_draft(topics: Path) -> None:
    """Do what the draft's remarks ask of a person: take the marks away, and say how far off distances are."""
    text = topics.read_text(encoding="utf-8")
    assert 'epc = "data{}.tag.uid"' in text
    text = re.sub(r"# (distance = \S+).*", r"\1\ndistance_sigma = 0.15\ndistance_unit = 'm'", text)
    topics.write_text(re.sub(r'# (facing = "front").*', r"\1", text), encoding="utf-8")

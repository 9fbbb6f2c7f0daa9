"""The tutorial of the first contract, typed as it is written: files, commands, and what they are said to show."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from tests.cluster.network_under_test import find_base_port

TUTORIAL = Path(__file__).resolve().parents[2] / "docs" / "tutorial" / "your-first-contract.md"
FENCE = re.compile(r"^```(\w+)(?: ([^\n]*))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SAMPLE_ID = "1159e96aab94"
SAMPLE_TXID = "408374439e1dc512691a30162ed157320f1a8e2d4863a294ef429d6d8906144b"
COMMAND_TIMEOUT_S = 180


@dataclass
class Reader:
    """Does what the page says, in a folder of its own, with the ids that commands tell in place of the page's."""

    folder: Path
    base_port: int
    shown: dict[str, str] = field(default_factory=dict)
    proposal: str = ""
    txid: str = ""

    def type(self, command: str, *, fails: bool = False) -> str:
        typed = command.replace(SAMPLE_ID, self.proposal).replace(SAMPLE_TXID, self.txid)
        if typed == "blockrobot up":
            typed = f"blockrobot up --base-port {self.base_port}"
        environment = {
            **os.environ,
            "BLOCKROBOT_HOME": str(self.folder / "home"),
            "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}",
            "COLUMNS": "200",
        }
        done = subprocess.run(
            ["bash", "-c", typed],
            cwd=self.folder,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
            timeout=COMMAND_TIMEOUT_S,
        )
        assert (done.returncode != 0) == fails, f"{typed}\n{done.stdout}\n{done.stderr}"
        if found := re.search(r"Its id is (\w{12})", done.stdout):
            self.proposal = found[1]
        if found := re.search(r"txid (\w{64})", done.stdout):
            self.txid = found[1]
        self.shown[command] = done.stdout
        return done.stdout

    def follow(self, page: str) -> None:
        for kind, remark, content in FENCE.findall(page):
            if kind == "sh":
                for command in content.strip().splitlines():
                    self.type(command, fails=remark == "fails")
            else:
                how, _, name = remark.partition("=")
                path = self.folder / name
                before = path.read_text(encoding="utf-8") + "\n\n" if how == "append" else ""
                path.write_text(before + content, encoding="utf-8")


@pytest.fixture
def reader(tmp_path: Path) -> Iterator[Reader]:
    reader = Reader(tmp_path, find_base_port(4))
    yield reader
    reader.type("blockrobot down")


def test_the_tutorial_works_as_it_is_written(reader: Reader) -> None:
    reader.follow(TUTORIAL.read_text(encoding="utf-8"))
    shown = reader.shown
    assert "wheelchairs.py: fine, 3 entries" in shown["blockrobot contract check wheelchairs.py"]
    tested = shown["blockrobot contract test --lines"]
    assert "2 passed" in tested
    assert "100%" in tested
    assert "3 passed" in shown["blockrobot contract test"]
    refused = shown["blockrobot contract call wheelchairs take 3 South --as university"]
    assert "Refused: CHAIR_TAKEN: Ward North has it." in refused
    assert "place = 0x63686169722f00000003" in shown[f"blockrobot contract trace {SAMPLE_TXID}"]
    events = shown["blockrobot contract events --contract wheelchairs --state wheelchairs.cursor"]
    assert 'wheelchairs.taken {"ward": "North", "chair": 3}' in events
    assert "where(chair: int) -> dict | None" in shown["blockrobot contract diff wheelchairs wheelchairs.py"]
    carried = shown["blockrobot contract query wheelchairs where 3"]
    assert '"ward": "North"' in carried
    assert '"since": 1' in carried
    assert "where" not in shown["blockrobot contract show wheelchairs --abi"]
    assert "OK: final" in shown["blockrobot contract call wheelchairs bring_back 3 --as university"]
    assert str(list(range(1, 13))) in shown["blockrobot contract query wheelchairs free"]

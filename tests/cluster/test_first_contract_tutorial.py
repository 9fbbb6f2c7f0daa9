"""The tutorial of the first contract, typed as it is written: files, commands, and what they are said to show."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cluster.network_under_test import find_base_port
from tests.cluster.tutorial_reader import Placeholders, Reader

TXID = "408374439e1dc512691a30162ed157320f1a8e2d4863a294ef429d6d8906144b"
PLACEHOLDERS = {
    "1159e96aab94": r"Its id is (\w{12})",
    TXID: r"txid (\w{64})",
}


@pytest.fixture
def reader(tmp_path: Path) -> Iterator[Reader]:
    """A reader who has a clone of BlockRobot, and nothing else."""
    reader = Reader(tmp_path, Placeholders(PLACEHOLDERS), base_port=find_base_port(4))
    yield reader
    reader.close()


@pytest.mark.docs
def test_the_tutorial_works_as_it_is_written(reader: Reader) -> None:
    reader.follow("your-first-contract.md")
    shown = reader.shown
    tested = shown["blockrobot contract test --lines"]
    assert "2 passed" in tested
    assert "100%" in tested
    assert "3 passed" in shown["blockrobot contract test"]
    refused = shown["blockrobot contract call wheelchairs take 3 South --as university"]
    assert "Refused: CHAIR_TAKEN: Ward North has it." in refused
    assert "place = 0x63686169722f00000003" in shown[f"blockrobot contract trace {TXID}"]
    events = shown["blockrobot contract events --contract wheelchairs --state wheelchairs.cursor"]
    assert 'wheelchairs.taken {"ward": "North", "chair": 3}' in events
    assert "where(chair: int) -> dict | None" in shown["blockrobot contract diff wheelchairs wheelchairs.py"]
    carried = shown["blockrobot contract query wheelchairs where 3"]
    assert '"ward": "North"' in carried
    assert '"since": 1' in carried
    assert "where" not in shown["blockrobot contract show wheelchairs --abi"]
    assert "OK: final" in shown["blockrobot contract call wheelchairs bring_back 3 --as university"]
    assert str(list(range(1, 13))) in shown["blockrobot contract query wheelchairs free"]

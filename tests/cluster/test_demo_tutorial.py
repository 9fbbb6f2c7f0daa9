"""The demonstration by hand, typed as it is written: a network, a robot, a patient, her wallet, and what they show."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cluster.network_under_test import find_base_port
from tests.cluster.tutorial_reader import Placeholders, Reader

PLACEHOLDERS = {
    "BR1-...": r"^(BR1-[A-Z2-7-]+)$",
    "MEMBER_KEY": r"blockrobot roster make --robot ([0-9a-f]{66})",
    "RECORD_ID": r"^  ([0-9a-f]{32})  .*, 5 pictures",
}
READING_MAX_S = 600
"""Where nothing else runs it takes about two minutes; the robot alone looks for forty seconds."""


@pytest.fixture
def reader(tmp_path: Path) -> Iterator[Reader]:
    """A reader who has a clone of BlockRobot, and nothing else."""
    reader = Reader(tmp_path, Placeholders(PLACEHOLDERS), base_port=find_base_port(4))
    yield reader
    reader.close()


@pytest.mark.docs
@pytest.mark.timeout(READING_MAX_S)
def test_the_demonstration_by_hand_works_as_it_is_written(reader: Reader) -> None:
    reader.follow("demo-by-hand.md")
    playground = reader.home / "playground"
    assert "│node-2 │stopped │" in reader.shown["blockrobot status"]
    assert "peer_connected" in reader.shown["blockrobot logs node-1"]
    assert not (playground / "uid").exists()
    for folder, count in (("pictures", 5), ("fewer", 3)):
        assert len(list((playground / folder).glob("*/*.depth.png"))) == count
        assert len(list((playground / folder).glob("*/animation.gif"))) == 1
    assert (playground / "my-data" / "play.html").stat().st_size > 0

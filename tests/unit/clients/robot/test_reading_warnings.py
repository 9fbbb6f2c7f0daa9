"""What a run says of its readings before it begins, and the how-to's table of what decides: both from the matcher."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from clients.robot.cli.reading_warnings import READ_EVERY_MS, time_to_bind_s, warn_of_lens, warn_of_readings
from clients.robot.sensing.sensor_events import Facing
from clients.robot.sources.messages.topics import Topics, parse_topics

TAGS = '[[tags]]\ntopic = "/rfid"\nepc = "data{}.uid"\n'
DISTANCE = 'distance = "data{}.range"\ndistance_sigma = 0.15\ndistance_unit = "m"\n'
HOW_TO = Path(__file__).parents[4] / "docs" / "how-to" / "your-robot.md"


def warned(text: str) -> list[str]:
    return list(warn_of_readings(parse_topics(text)))


def test_readings_without_a_distance_are_said_to_keep_nothing_and_distances_alone_only_who_walks() -> None:
    (warning,) = warned(TAGS)
    assert "/rfid" in warning
    assert "no-distance" in warning
    (warning,) = warned('[[llrp]]\nhost = "10.0.0.7"\n')
    assert "no-distance" in warning
    (warning,) = warned(TAGS + DISTANCE)
    assert 'facing = "front"' in warning
    assert "stand still" in warning
    assert "after about 4 s" in warning
    assert list(warn_of_readings(Topics())) == []


@pytest.mark.parametrize("facing", ['facing = "front"', 'antenna = "data{}.antenna"\nfront = [1]'])
def test_who_says_which_way_the_antenna_looks_is_warned_of_nothing(facing: str) -> None:
    assert warned(TAGS + DISTANCE + facing) == []


def test_a_recording_that_tells_no_focal_length_is_warned_of() -> None:
    (said,) = warn_of_lens(None)
    assert "No focal length is known: 525 pixels are assumed" in said
    assert list(warn_of_lens(131.0)) == []


def decided_rows() -> list[tuple[str, str, str, str]]:
    rows = re.findall(r"^\| (\d+\.\d+) m \| (.+) \| (.+) \| (.+) \|$", HOW_TO.read_text(), re.MULTILINE)
    assert rows
    return [tuple(cell.strip() for cell in row) for row in rows]  # type: ignore[misc]


@pytest.mark.parametrize("row", decided_rows())
def test_the_table_of_what_decides_says_what_the_matcher_does(row: tuple[str, str, str, str]) -> None:
    sigma, faced, stands, walks = row
    cases = ((faced, Facing.FRONT, False), (stands, Facing.UNKNOWN, False), (walks, Facing.UNKNOWN, True))
    for cell, facing, walking in cases:
        found = [time_to_bind_s(float(sigma), facing, READ_EVERY_MS, walks=walking, seed=seed) for seed in range(1, 6)]
        if cell == "never":
            assert found == [None] * 5
        else:
            first, _, last = cell.removesuffix(" s").partition(" to ")
            known = [one for one in found if one is not None]
            assert (min(known), max(known), len(known)) == (float(first), float(last or first), 5)

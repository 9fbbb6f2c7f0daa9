"""How many readings of how many tags were not on the roster, and nothing else of them."""

from __future__ import annotations

import pickle

import pytest

from clients.robot.pairing import rosters
from clients.robot.pairing.rosters import UnknownTagCounts, UnknownTags


def test_readings_and_tags_are_counted_apart_and_what_is_remembered_is_no_uid() -> None:
    unknown = UnknownTags()
    for uid in ("E1", "E2", "E1", "E1"):
        unknown.note(uid)
    assert unknown.summarise() == UnknownTagCounts(readings=4, tags=2, more_tags=False)
    first, second = UnknownTags(), UnknownTags()
    for unknown in (first, second):
        unknown.note("E280116060000001")
        assert "E280116060000001" not in repr(vars(unknown))
        assert b"E280116060000001" not in pickle.dumps(vars(unknown))
    assert first._tags.isdisjoint(second._tags)


def test_a_crowd_of_tags_costs_no_more_memory_than_the_first_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rosters, "UNKNOWN_TAGS_MAX_COUNT", 3)
    unknown = UnknownTags()
    for number in range(10):
        unknown.note(f"E{number}")
    unknown.note("E0")
    assert unknown.summarise() == UnknownTagCounts(readings=11, tags=3, more_tags=True)

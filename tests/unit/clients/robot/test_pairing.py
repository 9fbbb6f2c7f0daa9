"""Pairing at its edges: the window's ends, strangers' tags, old frames, and time that passes without frames."""

from __future__ import annotations

import pytest

from clients.robot.pairing import MEMORY_MS, NOT_PAIRED_NO_TAG, NOT_PAIRED_UNKNOWN_TAG, Pairing
from consensus.errors import BlockRobotError


def test_the_window_is_closed_at_both_ends() -> None:
    pairing = Pairing()
    pairing.add_sighting("a", 10_000, 10_000)
    decided = [d for i, at in enumerate((4_999, 5_000, 15_000, 15_001)) for d in pairing.add_frame(i, at)]
    assert [d.owners for d in decided + pairing.flush()] == [(), ("a",), ("a",), ()]


def test_a_sighting_at_the_last_instant_still_counts() -> None:
    pairing = Pairing()
    assert pairing.add_frame(0, 0) == []
    assert pairing.advance(6_000) == []
    pairing.add_sighting("a", 5_000, 5_000)
    (decision,) = pairing.advance(6_001)
    assert decision.owners == ("a",)


def test_only_unknown_tags_are_said_to_be_unknown() -> None:
    pairing = Pairing()
    pairing.add_sighting("x", 0, 0, known=False)
    decided = [*pairing.add_frame(0, 0), *pairing.add_frame(1, 20_000), *pairing.flush()]
    assert [d.reason for d in decided] == [NOT_PAIRED_UNKNOWN_TAG, NOT_PAIRED_NO_TAG]


def test_a_known_tag_outweighs_an_unknown_one() -> None:
    pairing = Pairing()
    pairing.add_frame(0, 0)
    pairing.add_sighting("x", 0, 0, known=False)
    pairing.add_sighting("b", 0, 0)
    (decision,) = pairing.flush()
    assert (decision.owners, decision.reason) == (("b",), "")


def test_a_frame_older_than_memory_is_refused() -> None:
    pairing = Pairing()
    pairing.add_frame(0, MEMORY_MS + 1_000)
    with pytest.raises(BlockRobotError, match="FRAME_INVALID"):
        pairing.add_frame(1, 999)


def test_memory_of_sightings_is_bounded() -> None:
    pairing = Pairing()
    for second in range(1_000):
        pairing.add_sighting(f"tag-{second}", second * 1_000, second * 1_000)
        pairing.add_frame(second, second * 1_000)
    assert len(pairing._known) < 70

"""Reading what the chain keeps of consents: whatever is not understood is a no."""

from __future__ import annotations

from typing import Any

import pytest

from consensus.state.consent import GIVEN, StepRow, effective_consent, read_choices

YES = [5, GIVEN, 100, 0, 0, b""]


def test_steps_are_read_by_purpose_and_sensor() -> None:
    row = {"care": {"depth": [YES, [9, "withdrawn", 200, 0, 0, b"m"]], "rgb": [YES]}}
    assert read_choices(row) == {
        ("care", "depth"): (StepRow(5, GIVEN, 100, 0, 0, b""), StepRow(9, "withdrawn", 200, 0, 0, b"m")),
        ("care", "rgb"): (StepRow(5, GIVEN, 100, 0, 0, b""),),
    }
    assert read_choices(None) == {}
    paused = {"care": {"depth": [YES, [9, "paused", 200, 0, 0, b""]], "rgb": [YES]}}
    assert read_choices(paused) == {("care", "rgb"): (StepRow(5, GIVEN, 100, 0, 0, b""),)}


@pytest.mark.parametrize(
    "row",
    [
        7,
        [],
        {"care": [YES]},
        {"care": {"depth": YES}},
        {"care": {"depth": []}},
        {"care": {"depth": [YES[:5]]}},
        {"care": {"depth": [[*YES, 1]]}},
        {"care": {"depth": [["5", GIVEN, 100, 0, 0, b""]]}},
        {"care": {"depth": [[True, GIVEN, 100, 0, 0, b""]]}},
        {"care": {"depth": [YES, None]}},
    ],
)
def test_a_form_that_is_not_known_is_no_consent(row: Any) -> None:
    assert read_choices(row) == {}


@pytest.mark.parametrize("status", ["Given", "yes", "", "withdrawn", "refused", "paused"])
def test_only_one_word_is_a_yes(status: str) -> None:
    assert effective_consent((StepRow(1, status, 0, 0, 0, b""),), 10) is None


def test_what_holds_is_the_last_that_was_reached_and_a_coming_no_counts_at_once() -> None:
    yes, later = StepRow(5, GIVEN, 1, 0, 0, b""), StepRow(20, GIVEN, 2, 0, 0, b"")
    no = StepRow(9, "withdrawn", 3, 0, 0, b"")
    assert effective_consent((), 10) is None
    assert effective_consent((yes,), 4) is None
    assert effective_consent((yes,), 5) == yes
    assert effective_consent((yes, later), 19) == yes
    assert effective_consent((yes, later), 20) == later
    assert effective_consent((yes, no), 6) is None
    assert effective_consent((yes, no, later), 8) is None
    assert effective_consent((yes, no, later), 19) is None
    assert effective_consent((yes, no, later), 20) == later

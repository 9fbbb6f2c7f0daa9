"""What the robot's command says of consent at the end of a run, to a person."""

from __future__ import annotations

import pytest

from clients.robot.cli import _tell_consents
from clients.robot.consents import ConsentFigures


def said(figures: ConsentFigures, output: pytest.CaptureFixture[str]) -> str:
    _tell_consents(figures.as_json())
    return output.readouterr().out


def test_a_run_in_which_consent_was_no_matter_says_nothing_of_it(capsys: pytest.CaptureFixture[str]) -> None:
    assert said(ConsentFigures(readings=90, failures=3), capsys) == ""


def test_what_stood_in_the_way_is_said_in_plain_words(capsys: pytest.CaptureFixture[str]) -> None:
    figures = ConsentFigures(
        stale_count=1, stale_ms=61_400, sightings_refused={"no-consent": 7, "registry-stale": 2}, clips_dropped=3
    )
    text = said(figures, capsys)
    assert "For 61 s nobody's consent could be proved" in text
    assert "7 readings were of tags whose bearers do not consent" in text
    assert "3 sealed clips were destroyed" in text

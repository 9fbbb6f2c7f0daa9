"""What the robot's command says of consent at the end of a run, to a person."""

from __future__ import annotations

from clients.robot.cli.run_report import consent_lines
from clients.robot.consent.consent_view import ConsentFigures


def said(figures: ConsentFigures) -> str:
    return "\n".join(consent_lines(figures.summarise()))


def test_no_consent_says_nothing_and_one_just_given_is_not_called_a_no() -> None:
    assert said(ConsentFigures(readings=90, failures=3)) == ""
    text = said(ConsentFigures(sightings_refused={"consent-coming": 29}))
    assert "29 readings were of tags whose bearers' consent had not begun" in text
    assert "do not consent" not in text


def test_what_stood_in_the_way_is_said_in_plain_words() -> None:
    figures = ConsentFigures(
        stale_count=1, stale_ms=61_400, sightings_refused={"no-consent": 7, "registry-stale": 2}, clips_dropped=3
    )
    text = said(figures)
    assert "For 61 s nobody's consent could be proved, and nothing was kept meanwhile." in text
    assert "7 readings were of tags whose bearers do not consent" in text
    assert "had not begun" not in text
    assert "3 sealed clips were destroyed" in text

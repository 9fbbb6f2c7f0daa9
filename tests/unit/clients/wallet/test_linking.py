"""Who acts on several visits at once is told what that gives away."""

from __future__ import annotations

import pytest

from clients.wallet.linking import tell_linked


def test_of_several_visits_she_is_told_that_they_are_linked(capsys: pytest.CaptureFixture[str]) -> None:
    tell_linked(3)
    captured = capsys.readouterr()
    assert "3 of your visits" in captured.err
    assert captured.out == ""


@pytest.mark.parametrize("visit_count", [0, 1])
def test_of_one_visit_there_is_nothing_to_say(visit_count: int, capsys: pytest.CaptureFixture[str]) -> None:
    tell_linked(visit_count)
    assert capsys.readouterr().err == ""

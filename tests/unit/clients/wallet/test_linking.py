"""Who acts on several visits at once is told what that gives away."""

from __future__ import annotations

import pytest

from clients.wallet.cli.wallet_context import print_linked_moves, print_linking_notice


def test_of_several_visits_she_is_told_that_they_are_linked(capsys: pytest.CaptureFixture[str]) -> None:
    print_linking_notice(3)
    captured = capsys.readouterr()
    assert "3 of your visits" in captured.err
    assert captured.out == ""


@pytest.mark.parametrize("visit_count", [0, 1])
def test_of_one_visit_there_is_nothing_to_say(visit_count: int, capsys: pytest.CaptureFixture[str]) -> None:
    print_linking_notice(visit_count)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("visit_count", "with_member", "told"),
    [
        (
            3,
            True,
            "3 of your visits get a new key at once: whoever reads the ledger can tell, for ever, whose they are.",
        ),
        (1, True, "1 of your visits gets a new key at once: whoever reads the ledger can tell, for ever, whose it is."),
        (3, False, "that they are one person's."),
        (1, False, ""),
        (0, True, ""),
    ],
)
def test_who_moves_visits_at_once_is_told_of_the_other_way_and_not_to_name_records(
    visit_count: int, with_member: bool, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    print_linked_moves(visit_count, with_member=with_member)
    said = capsys.readouterr().err
    assert told in said
    assert ("--over-minutes" in said) == bool(told)
    assert "name records" not in said

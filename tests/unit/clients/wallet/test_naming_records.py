"""Naming a record by the beginning of its id, as the wallet's own list and pages do."""

from __future__ import annotations

import pytest

from clients.wallet.ledger.visit_scan import resolve_record
from consensus.errors import BlockRobotError

KNOWN = ["3fa2c19b07de5a41b6f0c2d4e8a19377", "3fa9000000000000000000000000000a"]


@pytest.mark.parametrize("wanted", [KNOWN[0], "3fa2c19b07de", "3FA2"])
def test_the_beginning_of_an_id_is_enough(wanted: str) -> None:
    assert resolve_record(KNOWN, wanted) == KNOWN[0]


@pytest.mark.parametrize(
    ("wanted", "said"),
    [("77", "RECORD_NOT_FOUND: You have no record"), ("3fa", "NAME_AMBIGUOUS: 2 records"), ("", "NAME_TOO_SHORT")],
)
def test_what_names_none_or_several_is_refused(wanted: str, said: str) -> None:
    with pytest.raises(BlockRobotError, match=said) as refusal:
        resolve_record(KNOWN, wanted)
    assert "identifier" not in refusal.value.next_step

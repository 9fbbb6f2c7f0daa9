"""Finds the one thing that the beginning of an id means: a record, a visit, a grant, a breach, a proposal, a mandate.

Each thing that is not found has its own code, so that the next step names the list.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from clients.wallet.present.translations import refusal


@dataclass(frozen=True, slots=True)
class Thing:
    """What is named: its word in the catalogue, the code where there is none, and how many characters it takes at least."""

    one: str
    missing_code: str
    min_chars: int = 8


RECORD = Thing("record", "RECORD_NOT_FOUND", 1)
VISIT = Thing("visit", "VISIT_NOT_FOUND")
GRANT = Thing("share", "GRANT_NOT_FOUND")
BREACH = Thing("breach", "BREACH_NOT_FOUND")
PROPOSAL = Thing("proposal", "PROPOSAL_NOT_FOUND")
MANDATE = Thing("mandate", "MANDATE_NOT_FOUND")


def find_named(thing: Thing, ids: Sequence[str], start: str) -> int:
    """Return the place of the one id (hexadecimal) that begins so.

    Raises NAME_TOO_SHORT, NAME_AMBIGUOUS, or the thing's own code if there is none.
    """
    if len(start) < thing.min_chars:
        raise refusal("NAME_TOO_SHORT", f"short.{thing.one}", count=thing.min_chars, start=start, given=len(start))
    found = [place for place, known in enumerate(ids) if known.startswith(start.lower())]
    if not found:
        raise refusal(thing.missing_code, f"missing.{thing.one}", start=start)
    if len(found) > 1:
        raise refusal("NAME_AMBIGUOUS", f"several.{thing.one}", count=len(found), start=start)
    return found[0]

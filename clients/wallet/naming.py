"""Finds the one thing that the beginning of an id means: a record, a visit, a grant, a breach, a proposal.

Must never choose one of several. Each thing that is not found has its own code, so that the next step names the list.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from consensus.errors import BlockRobotError


@dataclass(frozen=True, slots=True)
class Thing:
    """What is named: in words (one, several), the code where there is none, and how many characters it takes at least."""

    one: str
    many: str
    missing_code: str
    min_chars: int = 8


RECORD = Thing("record", "records", "RECORD_NOT_FOUND", 1)
VISIT = Thing("visit", "visits", "VISIT_NOT_FOUND")
GRANT = Thing("share", "shares", "GRANT_NOT_FOUND")
BREACH = Thing("breach", "breaches", "BREACH_NOT_FOUND")
PROPOSAL = Thing("proposal", "proposals", "PROPOSAL_NOT_FOUND")


def find_named(thing: Thing, ids: Sequence[str], start: str) -> int:
    """Return the place of the one id (hexadecimal) that begins so.

    Raises NAME_TOO_SHORT, NAME_AMBIGUOUS, or the thing's own code if there is none.
    """
    if len(start) < thing.min_chars:
        text = f"Name a {thing.one} by at least {thing.min_chars} characters: {start!r} has {len(start)}."
        raise BlockRobotError("NAME_TOO_SHORT", text)
    found = [place for place, known in enumerate(ids) if known.startswith(start.lower())]
    if not found:
        raise BlockRobotError(thing.missing_code, f"You have no {thing.one} whose name begins with {start}.")
    if len(found) > 1:
        text = f"{len(found)} {thing.many} have names that begin with {start}."
        raise BlockRobotError("NAME_AMBIGUOUS", text)
    return found[0]

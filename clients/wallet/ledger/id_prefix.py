"""Resolve id prefixes of records, visits, grants, breaches, proposals and mandates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from clients.wallet.text_catalogue import refusal


@dataclass(frozen=True, slots=True)
class IdKind:
    """Kind of thing: catalogue word, not-found code, minimum prefix length."""

    one: str
    missing_code: str
    min_chars: int = 8


RECORD = IdKind("record", "RECORD_NOT_FOUND", 1)
VISIT = IdKind("visit", "VISIT_NOT_FOUND")
GRANT = IdKind("share", "GRANT_NOT_FOUND")
BREACH = IdKind("breach", "BREACH_NOT_FOUND")
PROPOSAL = IdKind("proposal", "PROPOSAL_NOT_FOUND")
MANDATE = IdKind("mandate", "MANDATE_NOT_FOUND")


def resolve_id_prefix(thing: IdKind, ids: Sequence[str], start: str) -> int:
    """Return the index among `ids` (hex). Raises NAME_TOO_SHORT, NAME_AMBIGUOUS, or the thing's own code."""
    if len(start) < thing.min_chars:
        raise refusal("NAME_TOO_SHORT", f"short.{thing.one}", count=thing.min_chars, start=start, given=len(start))
    found = [place for place, known in enumerate(ids) if known.startswith(start.lower())]
    if not found:
        raise refusal(thing.missing_code, f"missing.{thing.one}", start=start)
    if len(found) > 1:
        raise refusal("NAME_AMBIGUOUS", f"several.{thing.one}", count=len(found), start=start)
    return found[0]

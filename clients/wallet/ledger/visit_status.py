"""A visit's rights status from owner and officers, proven complete."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from clients.wallet.ledger.visit_audit import AuditEntry
from consensus.state.keys import Values
from consensus.state.rights import CORRECTION_COUNT, OBJECTION, QUARANTINE, RESTRICTION, RestrictionRow

OFFICERS_KIND = "erased_by_officers"


@dataclass(frozen=True, slots=True)
class BreachEnd:
    """How an officer ended a denial's breach."""

    breach_id: bytes
    outcome: str
    reason: str
    time_ms: int


@dataclass(frozen=True, slots=True)
class OfficersErasure:
    """An erasure by two officers, with reason."""

    proposal_id: bytes
    reason: str
    records: int
    time_ms: int


@dataclass(frozen=True, slots=True)
class VisitRights:
    """A visit's rights status. `breach_id` is set during quarantine; permanently if it ended as erased."""

    restriction: RestrictionRow | None = None
    objections: tuple[str, ...] = ()
    corrections_count: int = 0
    breach_id: bytes = b""
    breach_end: BreachEnd | None = None
    officers: tuple[OfficersErasure, ...] = ()

    def restricts(self, record_id: bytes) -> bool:
        return self.restriction is not None and self.restriction.covers(record_id)


def read_rights(values: Values, owner: bytes, audit: Sequence[AuditEntry]) -> VisitRights:
    """By first owner key, from proved values and audit."""
    return VisitRights(
        RESTRICTION.among(values, owner),
        tuple(sorted(OBJECTION.among(values, owner) or {})),
        CORRECTION_COUNT.among(values, owner) or 0,
        QUARANTINE.among(values, owner) or b"",
        _read_end(audit),
        tuple(
            OfficersErasure(entry.data["proposal_id"], entry.data["reason"], entry.data["records"], entry.time_ms)
            for entry in audit
            if entry.kind == OFFICERS_KIND
        ),
    )


def _read_end(audit: Sequence[AuditEntry]) -> BreachEnd | None:
    """None if denied again since."""
    end = None
    for entry in audit:
        if entry.kind == "denied":
            end = None
        elif entry.kind == "breach_closed":
            end = BreachEnd(entry.data["breach_id"], entry.data["outcome"], entry.data["reason"], entry.time_ms)
    return end

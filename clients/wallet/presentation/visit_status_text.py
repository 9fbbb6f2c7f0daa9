"""Rights status of a visit, for people and programs."""

from __future__ import annotations

from functools import partial

from clients.sdk.terminal.terminal import console
from clients.wallet.answers.record_answers import (
    ErasedByOfficers,
    VisitBreachEnd,
    VisitRestriction,
    VisitRightsRow,
)
from clients.wallet.ledger.visit_status import VisitRights
from clients.wallet.presentation.translations import code_text, purposes_text, text
from consensus.rights.right_codes import LOST_KEY_REASONS
from pages.time_format import format_time


def rights_row(rights: VisitRights) -> VisitRightsRow:
    row, end = rights.restriction, rights.breach_end
    return VisitRightsRow(
        restriction=None
        if row is None
        else VisitRestriction(ground=row.ground, whole_visit=row.whole, kept_until_ms=row.until_ms or None),
        objected_purposes=list(rights.objections),
        corrections=rights.corrections_count,
        breach_id=rights.breach_id.hex() or None,
        breach_end=None
        if end is None
        else VisitBreachEnd(breach_id=end.breach_id.hex(), outcome=end.outcome, reason=end.reason, time_ms=end.time_ms),
        erased_by_officers=[
            ErasedByOfficers(
                proposal_id=one.proposal_id.hex(), reason=one.reason, records=one.records, time_ms=one.time_ms
            )
            for one in rights.officers
        ],
    )


def print_rights(rights: VisitRights) -> None:
    for line in rights_lines(rights):
        console.print(f"  {line}")


def rights_lines(rights: VisitRights, language: str | None = None) -> list[str]:
    say = partial(text, language=language)
    lines = _breach_lines(rights, language)
    for one in rights.officers:
        why = say(f"lost_key_reason.{one.reason}") if one.reason in LOST_KEY_REASONS else ""
        reason, moment = code_text("reason", one.reason, language=language), format_time(one.time_ms)
        name = one.proposal_id.hex()[:12]
        lines.append(say("visit_rights.officers", count=one.records, moment=moment, reason=reason, why=why, name=name))
    row = rights.restriction
    if row is not None:
        key, count = "visit_rights.restricted_whole" if row.whole else "visit_rights.restricted_some", len(row.records)
        kept = say("visit_rights.kept", moment=format_time(row.until_ms)) if row.until_ms else ""
        lines.append(say(key, count=count, ground=code_text("ground", row.ground, language=language), kept=kept))
    if rights.objections:
        lines.append(say("visit_rights.objected", purposes=purposes_text(rights.objections, language=language)))
    if rights.corrections_count:
        lines.append(say("visit_rights.corrections", count=rights.corrections_count))
    return lines


def _breach_lines(rights: VisitRights, language: str | None) -> list[str]:
    say, end = partial(text, language=language), rights.breach_end
    if end is not None:
        known = {"erased": "visit_rights.over_erased", "released": "visit_rights.over_released"}.get(end.outcome)
        what = say(known) if known else end.outcome
        reason = code_text("reason", end.reason, language=language)
        return [say("visit_rights.over", moment=format_time(end.time_ms), what=what, reason=reason)]
    if rights.breach_id:
        return [say("visit_rights.denied", name=rights.breach_id.hex()[:12])]
    return []

"""Rights status of a visit, for people and programs."""

from __future__ import annotations

from functools import partial

from clients.sdk.terminal.terminal import console
from clients.wallet.ledger.visit_status import VisitRights
from clients.wallet.presentation.record_answers import ErasedByOfficers, VisitBreachEnd, VisitRestriction, VisitStanding
from clients.wallet.presentation.translations import code_text, purposes_text, text
from consensus.rights.right_codes import LOST_KEY_REASONS
from pages.time_format import format_time


def standing_answer(standing: VisitRights) -> VisitStanding:
    row, end = standing.restriction, standing.breach_end
    return VisitStanding(
        restriction=None
        if row is None
        else VisitRestriction(ground=row.ground, whole_visit=row.whole, kept_until_ms=row.until_ms or None),
        objected_purposes=list(standing.objections),
        corrections=standing.corrections_count,
        breach_id=standing.breach_id.hex() or None,
        breach_end=None
        if end is None
        else VisitBreachEnd(breach_id=end.breach_id.hex(), outcome=end.outcome, reason=end.reason, time_ms=end.time_ms),
        erased_by_officers=[
            ErasedByOfficers(
                proposal_id=one.proposal_id.hex(), reason=one.reason, records=one.records, time_ms=one.time_ms
            )
            for one in standing.officers
        ],
    )


def print_standing(standing: VisitRights) -> None:
    for line in standing_lines(standing):
        console.print(f"  {line}")


def standing_lines(standing: VisitRights, language: str | None = None) -> list[str]:
    say = partial(text, language=language)
    lines = _breach_lines(standing, language)
    for one in standing.officers:
        why = say(f"lost_key_reason.{one.reason}") if one.reason in LOST_KEY_REASONS else ""
        reason, moment = code_text("reason", one.reason, language=language), format_time(one.time_ms)
        name = one.proposal_id.hex()[:12]
        lines.append(say("standing.officers", count=one.records, moment=moment, reason=reason, why=why, name=name))
    row = standing.restriction
    if row is not None:
        key, count = "standing.restricted_whole" if row.whole else "standing.restricted_some", len(row.records)
        kept = say("standing.kept", moment=format_time(row.until_ms)) if row.until_ms else ""
        lines.append(say(key, count=count, ground=code_text("ground", row.ground, language=language), kept=kept))
    if standing.objections:
        lines.append(say("standing.objected", purposes=purposes_text(standing.objections, language=language)))
    if standing.corrections_count:
        lines.append(say("standing.corrections", count=standing.corrections_count))
    return lines


def _breach_lines(standing: VisitRights, language: str | None) -> list[str]:
    say, end = partial(text, language=language), standing.breach_end
    if end is not None:
        known = {"erased": "standing.over_erased", "released": "standing.over_released"}.get(end.outcome)
        what = say(known) if known else end.outcome
        reason = code_text("reason", end.reason, language=language)
        return [say("standing.over", moment=format_time(end.time_ms), what=what, reason=reason)]
    if standing.breach_id:
        return [say("standing.denied", name=standing.breach_id.hex()[:12])]
    return []

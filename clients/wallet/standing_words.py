"""What stands of a visit, told to a person or a program. Must never tell more than was proven."""

from __future__ import annotations

from typing import Any

from clients.sdk.terminal import console
from clients.wallet.counting import counted
from clients.wallet.opening import show_moment
from clients.wallet.standing import VisitRights
from consensus.records.lost_keys import LOST_KEY_REASONS


def standing_json(standing: VisitRights) -> dict[str, Any]:
    """Return what stands of a visit by names, for a program."""
    row, end = standing.restriction, standing.breach_end
    return {
        "restriction": None
        if row is None
        else {"ground": row["ground"], "whole_visit": row["whole"], "kept_until_ms": row["until_ms"] or None},
        "objected_purposes": list(standing.objections),
        "corrections": standing.corrections_count,
        "breach_id": standing.breach_id.hex() or None,
        "breach_end": None
        if end is None
        else {
            "breach_id": end.breach_id.hex(),
            "outcome": end.outcome,
            "reason": end.reason,
            "time_ms": end.time_ms,
        },
        "erased_by_officers": [
            {
                "proposal_id": one.proposal_id.hex(),
                "reason": one.reason,
                "records": one.records,
                "time_ms": one.time_ms,
            }
            for one in standing.officers
        ],
    }


def print_standing(standing: VisitRights) -> None:
    """Tell a person what stands of a visit."""
    for line in standing_lines(standing):
        console.print(f"  {line}")


def standing_lines(standing: VisitRights) -> list[str]:
    """Say what stands of a visit in plain sentences."""
    lines = _breach_lines(standing)
    lines += [
        (
            f"Two officers together had {counted(one.records, 'record')} of this visit erased on"
            f" {show_moment(one.time_ms)}: {one.reason}. {LOST_KEY_REASONS.get(one.reason, '')} "
            "They name a robot and minutes, and the chain cannot say whose visits those are. If it was not you who "
            f"asked, ask the hospital about {one.proposal_id.hex()[:12]}."
        )
        for one in standing.officers
    ]
    row = standing.restriction
    if row is not None:
        some = counted(len(row["records"]), "record of this visit is", "records of this visit are")
        what = "All of this visit is" if row["whole"] else some
        kept = f", and kept until {show_moment(row['until_ms'])}" if row["until_ms"] else ""
        lines.append(f"{what} restricted ({row['ground']}): only you see it{kept}.")
    if standing.objections:
        lines.append(f"You objected to its release for: {', '.join(standing.objections)}.")
    if standing.corrections_count:
        lines.append(f"It has {standing.corrections_count} corrections of yours.")
    return lines


def _breach_lines(standing: VisitRights) -> list[str]:
    end = standing.breach_end
    if end is not None:
        what = {
            "erased": "an officer had it erased, and what is left stays closed to everyone",
            "released": "an officer found that it was yours, and it is open to you again",
        }.get(end.outcome, end.outcome)
        return [f"You denied this visit. That is over since {show_moment(end.time_ms)}: {what} ({end.reason})."]
    if standing.breach_id:
        name = standing.breach_id.hex()[:12]
        return [f"You denied this visit: nobody sees it until breach {name} is decided."]
    return []

"""An export bundle, in words and as an answer."""

from __future__ import annotations

from pathlib import Path

from clients.bundle.checks.bundle_check import Verdict, unproved
from clients.bundle.checks.frame_check import count_pictures
from clients.wallet.answers.record_answers import ExportAnswer, ExportProblem
from clients.wallet.export.export_building import Plan
from clients.wallet.presentation.translations import describe_error, text
from consensus.errors import CATALOGUE, BlockRobotError


def bundle_warning(plan: Plan, *, now: bool) -> list[str]:
    """What it discloses."""
    wanted = plan.wanted
    visits = text("count.visits", count=len(plan.visits))
    lines = [text("export.holds", visits=visits, records=text("count.records", count=plan.named_count))]
    learns = [
        ("export.joined", bool(plan.visits)),
        ("export.pictures", wanted.pictures and bool(plan.record_count)),
        ("export.identity", wanted.identity),
        ("export.no_key", True),
    ]
    lines += [f"  - {text(key)}" for key, is_so in learns if is_so]
    if wanted.pictures and len(plan.visits) > 1:
        lines.append(text("export.asks_at_once" if now else "export.asks_one_by_one"))
    lines.append(text("export.keep"))
    return lines


def export_answer(out: Path, verdict: Verdict) -> ExportAnswer:
    problems = verdict.manifest.problems
    return ExportAnswer(
        file=str(out),
        bytes=out.stat().st_size,
        is_complete=not problems,
        visits=len(verdict.visits),
        records=len(verdict.records),
        pictures=count_pictures(verdict.frames),
        audit_entries=verdict.events,
        accesses=verdict.accesses,
        erasures=verdict.erasures,
        consent_receipts=len(verdict.consents.history),
        signed_consent_receipts=len(verdict.signed),
        proved_until_height=verdict.as_of_height,
        genesis_id=verdict.manifest.genesis_id,
        problems=[ExportProblem(record_id=each.record_id, code=each.code, sentence=each.sentence) for each in problems],
        not_proved=unproved(verdict),
    )


def problem_text(code: str, sentence: str, language: str | None = None) -> str:
    """Outside English the code's meaning comes first."""
    return describe_error(BlockRobotError(code, sentence), language)[0] if code in CATALOGUE else sentence

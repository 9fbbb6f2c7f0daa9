"""The demonstration's output: report.html (self-contained), events.jsonl, summary.json."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
from msgspec import Struct

from clients.robot.recording.frame_answers import FrameCounts, RunLatencies
from clients.sdk.pictures.picture_names import read_robot_frame
from network.demo.checks import Check, CheckList
from network.demo.story import DRIVEN, DemoState
from network.demo.words import EVENTS, FRAMES, LATENCIES, name_person, quantiles_text, reasons_text
from network.report_page import Section, badge, build_report, gallery, picture, table, text, tiles

PICTURES_A_PERSON_COUNT = 4
_TILES = ("published", "kept", "withheld", "lost")


class DemoSummary(Struct, frozen=True, kw_only=True):
    """What the demonstration answers; null is what it did not come to."""

    ok: bool
    checks: list[Check]
    frames: FrameCounts | None
    blocks: int
    transactions: int
    latency_ms: RunLatencies | None
    leader_kill_gap_s: float | None
    nodes: int
    store: str
    out: str


def build_summary(checks: CheckList, state: DemoState, *, nodes: int, store: str, out: Path) -> DemoSummary:
    return DemoSummary(
        ok=checks.ok,
        checks=checks.checks,
        frames=state.summary.frames if state.summary else None,
        blocks=state.blocks,
        transactions=state.transactions,
        latency_ms=state.summary.latency_ms if state.summary else None,
        leader_kill_gap_s=state.kill.gap_s if state.kill else None,
        nodes=nodes,
        store=store.split("://", maxsplit=1)[0],
        out=str(out),
    )


def write_report(out: Path, summary: DemoSummary, state: DemoState) -> None:
    told = json.dumps(msgspec.to_builtins(summary), indent=2)
    (out / "summary.json").write_text(told + "\n", encoding="utf-8")
    (out / "report.html").write_text(_page(summary, state), encoding="utf-8")


def _page(summary: DemoSummary, state: DemoState) -> str:
    verdict = "Every check held." if summary.ok else "Not every check held."
    lead = (
        f"<p><strong>{verdict}</strong></p><p>Four nodes of two organisations ran on this machine; a robot recorded two "
        "patients and a visitor; the patients looked, checked and erased.</p>"
    )
    sections = [
        Section("What was checked", _tiles(summary) + _checks_table(summary.checks)),
        Section("What each patient sees", f"<p>Only themselves, on the recorded empty corridor.</p>{_pictures(state)}"),
        Section("While the robot drives", f"<p>Only themselves: the room is not shown.</p>{_on_the_way(state)}"),
        Section("What the robot kept", _figures_table(summary)),
        Section("Patient A's audit trail", _trail(state), new_sheet=True),
    ]
    return build_report("BlockRobot: what happened", lead, sections, lead_is_good=summary.ok)


def _tiles(summary: DemoSummary) -> str:
    held = sum(check.ok for check in summary.checks)
    figures = [(f"{held} of {len(summary.checks)}", "checks held")]
    if summary.frames is not None:
        figures += [(f"{getattr(summary.frames, key):,}", FRAMES[key]) for key in _TILES]
    figures.append((f"{summary.blocks:,}", "blocks"))
    return tiles(figures)


def _checks_table(checks: list[Check]) -> str:
    rows = [[badge(ok=check.ok), text(check.name), text(check.detail)] for check in checks]
    return table("Each check, and what was seen", ["", "Check", "Seen"], rows, numbers_from=3, stacked=True)


def _figures_table(summary: DemoSummary) -> str:
    rows: list[tuple[str, str | float | None]] = []
    for name, value in (msgspec.to_builtins(summary.frames) or {}).items():
        rows.append((FRAMES.get(name, name), reasons_text(value) if isinstance(value, dict) else f"{value:,}"))
    for name, values in (msgspec.to_builtins(summary.latency_ms) or {}).items():
        rows.append((f"{LATENCIES.get(name, name)} (ms)", quantiles_text(values)))
    rows += [
        ("blocks", summary.blocks),
        ("transactions", summary.transactions),
        ("without finality after the leader's death (s)", summary.leader_kill_gap_s),
    ]
    cells = [[text(name), "-" if value is None else text(value)] for name, value in rows]
    return table(
        "A frame counts once for each owner, except those published", ["Figure", "Value"], cells, numbers_from=2
    )


def _pictures(state: DemoState) -> str:
    figures = []
    for patient, pictures in state.pictures.items():
        figures += _some(pictures, f"{name_person(patient)}, frame", "on the recorded empty corridor")
    return gallery(figures) if figures else "<p>There are no pictures.</p>"


def _on_the_way(state: DemoState) -> str:
    figures = _some(state.on_the_way, f"{name_person(DRIVEN)}, on the way, frame", "on nothing")
    return gallery(figures) if figures else "<p>There are no pictures.</p>"


def _some(pictures: list[Path], label: str, where: str) -> list[str]:
    step = max(1, len(pictures) // PICTURES_A_PERSON_COUNT)
    figures = []
    for path in pictures[::step][:PICTURES_A_PERSON_COUNT]:
        caption = f"{label} {read_robot_frame(path.name)}"
        alternative = f"{caption}: their silhouette alone {where}, distance in colours"
        figures.append(picture(path.read_bytes(), alternative=alternative, caption=caption))
    return figures


def _trail(state: DemoState) -> str:
    rows = [
        [
            text(EVENTS.get(entry.kind, entry.kind)),
            text(entry.record_id[:12] or "the visit"),
            text(entry.height),
        ]
        for entry in state.audit
    ]
    return table(
        "Everything that happened to their records, in order", ["What", "Record", "Block"], rows, numbers_from=2
    )

"""An experiment's page in one file: checks, figures beside the published run, map, tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from clients.robot.recording.frame_answers import FrameCounts, RunLatencies
from clients.sdk.pictures.picture_names import read_robot_frame
from consensus.errors import BlockRobotError
from network.bench.conditions import Condition
from network.demo.checks import Check
from network.demo.words import name_person
from network.experiments.pages.map_picture import draw_svg
from network.experiments.pages.tables import HEADINGS, Row, activity_rows, figure_rows, pair_rows, show_value
from network.experiments.published_figures import SOURCE
from network.experiments.run_figures import RunFigures
from network.experiments.run_one import Outcome
from network.report_page import Section, badge, bar, build_report, drawing, gallery, picture, quiet, table, text

PICTURES_A_PERSON_COUNT = 3
_IN_MS = '<span class="visually-hidden">in milliseconds</span>'


def build_page(outcome: Outcome, refusal: BlockRobotError | None, drawn: str | None = None) -> str:
    """`drawn`: Graphviz's SVG map; `refusal`: why there is none."""
    experiment = outcome.experiment
    sections = [Section("What was checked", _checks(outcome.checks.checks) + quiet(_told(outcome.conditions)))]
    if outcome.reading is not None and outcome.robot is not None:
        figures, frames = outcome.reading.figures, outcome.robot.frames
        sections += [
            Section("What share was paired", _paired(outcome, figures, frames)),
            Section("Where the time goes", _times(outcome, figures, outcome.robot.latency_ms)),
            Section("What was lost", _lost(outcome, figures, frames)),
            Section(f"Beside {experiment.beside.name}", _side_by_side(outcome, figures)),
            Section("What follows what", _map(outcome, refusal, drawn), new_sheet=True),
            Section("What people see", _pictures(outcome)),
            Section("Statistics", _statistics(outcome), new_sheet=True),
        ]
    lead = f"{_verdict(outcome)}<p>{text(experiment.question)}</p>"
    return build_report(
        f"Experiment {experiment.number}: {experiment.title}", lead, sections, lead_is_good=bool(outcome.ok)
    )


def build_index(outcomes: Sequence[Outcome], seconds: float, conditions: Mapping[str, Condition]) -> str:
    rows = []
    for outcome in outcomes:
        held = sum(check.ok for check in outcome.checks.checks)
        frames = outcome.robot and outcome.robot.frames
        name = outcome.experiment.name
        rows.append(
            [
                f'<a href="{name}/report.html">{outcome.experiment.number}: {text(outcome.experiment.title)}</a>',
                badge(ok=outcome.ok),
                f"{held} of {len(outcome.checks.checks)}",
                *(f"{getattr(frames, key, 0):,}" for key in ("published", "covered", "kept", "withheld", "lost")),
            ]
        )
    headings = ["Experiment", "Claims", "Checks", "Frames", "Covered", "Kept", "Withheld", "Lost"]
    note = quiet(
        "Covered, kept, withheld and lost count a frame once for each owner. "
        f"All of it took {seconds:,.0f} s. {_told(conditions)}"
    )
    held = bool(outcomes) and all(outcome.ok for outcome in outcomes)
    checks = [check for outcome in outcomes for check in outcome.checks.checks]
    lead = "<p><strong>Every claim held.</strong></p>" if held else "<p><strong>Not every claim held.</strong></p>"
    lead += f"<p>{sum(check.ok for check in checks)} of {len(checks)} checks held. A name leads to its experiment.</p>"
    body = table("Each experiment, and what became of its frames", headings, rows, numbers_from=3) + note
    return build_report("The experiments", lead, [Section("What was run", body)], lead_is_good=held)


def _told(conditions: Mapping[str, Condition]) -> str:
    shown = {key: value for key, value in conditions.items() if value is not None and key != "scenarios"}
    listed = ", ".join(f"{key.replace('_', ' ')} {value}" for key, value in shown.items())
    return f"Measured with: {text(listed)}. A load above the cores means that others worked too."


def _verdict(outcome: Outcome) -> str:
    if outcome.ok:
        return "<p><strong>Every check held.</strong></p>"
    return "<p><strong>Not every check held.</strong></p>"


def _checks(checks: Sequence[Check]) -> str:
    rows = [[badge(ok=check.ok), text(check.name), text(check.detail)] for check in checks]
    return table("Each check, and what was seen", ["", "Check", "Seen"], rows, numbers_from=3)


def _percent(part: float, whole: float) -> str:
    return f"{100 * part / whole:.1f} %" if whole else "0 %"


def _paired(outcome: Outcome, figures: RunFigures, frames: FrameCounts) -> str:
    theirs = outcome.experiment.beside.figures
    received, covered = theirs["frames received"], theirs["frames received within 5 s of a reading, by arrival"]
    return (
        f"<p>{figures.frames_received:,} frames were received. {figures.frames_covered:,} of them "
        f"({_percent(figures.frames_covered, figures.frames_received)}) arrived within five seconds of a tag's reading. "
        f"Pairing goes by when a frame was taken, not by when it arrived: {figures.frames_paired:,} were paired with a "
        f"registered tag, which makes {frames.covered:,} frames and owners, since a frame belongs to everybody whose "
        f"tag was near. Of these, {frames.kept:,} "
        f"({_percent(frames.kept, frames.covered)}) are on the chain, and {frames.withheld:,} were withheld.</p>"
        f"<p>The prototype received {received:,.0f} frames, {covered:,.0f} of them within five seconds of a reading, and "
        f"paired {theirs['frames paired']:,.0f} ({_percent(theirs['frames paired'], received)})."
        f"{text(outcome.experiment.beside.remark)}</p>"
    )


def _times(outcome: Outcome, figures: RunFigures, latency: RunLatencies) -> str:
    theirs = outcome.experiment.beside.figures
    rows = []
    ways = [("received to paired", "received to paired"), ("paired to on the chain", "paired to on the chain")]
    ways.append(("received to on the chain", "received to on the chain"))
    longest = max(
        [figures.stretches[name].mean_ms for name, _ in ways] + [theirs[f"{name}, mean (ms)"] for name, _ in ways]
    )
    for name, _ in ways:
        ours, other = figures.stretches[name].mean_ms, theirs[f"{name}, mean (ms)"]
        rows.append([name, bar(ours, longest, 1), f"{ours:,.0f} ms", bar(other, longest, 2), f"{other:,.0f} ms"])
    window = latency.frame_to_final
    return (
        "<p>A frame is paired when nothing that may still arrive can change its owners: five seconds for readings to "
        "come, one for those that come late. That wait is most of the way, and it is chosen. The prototype paired at "
        "once, with what it had. Ours is on the chain when it is final, by a quorum; theirs when one producer took it.</p>"
        + table(
            "From one step to the next, on average", ["Mean", "ours", _IN_MS, "theirs", _IN_MS], rows, numbers_from=5
        )
        + f"<p>From the end of the five seconds to final: median {window.p50:,.0f} ms, 95 in 100 within "
        f"{window.p95:,.0f} ms, at most {window.max:,.0f} ms (longer where whom a silhouette belongs to was settled "
        f"only by later readings). From submission to final: median {latency.submit_to_final.p50:,.0f} ms.</p>"
    )


def _lost(outcome: Outcome, figures: RunFigures, frames: FrameCounts) -> str:
    theirs = outcome.experiment.beside.figures
    reasons = ", ".join(f"{text(name)} {count:,}" for name, count in frames.withheld_reasons.items())
    return (
        f"<p>{figures.frames_published - figures.frames_received:,} of {figures.frames_published:,} frames did not arrive; "
        f"of those that had an owner, {frames.lost:,} were lost. The prototype lost "
        f"{theirs['frames lost before they arrived (%)']:.1f} % of its frames before they arrived.</p>"
        f"<p>Withheld is not lost: who cannot be shown alone is not shown, and their wallet tells them so with the reason. "
        f"Here: {reasons or 'none'}. (no-silhouette: they were not to be seen; ambiguous: it could not be settled which "
        "silhouette was theirs; contact, merged, occluded: somebody was too near or in front.) The prototype gave "
        "everybody the whole frame, the others included.</p>"
    )


def _side_by_side(outcome: Outcome, figures: RunFigures) -> str:
    theirs = outcome.experiment.beside.figures
    rows = [[text(name), show_value(value), show_value(theirs.get(name))] for name, value in figure_rows(figures)]
    return table("Figures of both runs", ["Figure", "ours", "theirs"], rows) + quiet(
        f"Theirs: {text(SOURCE)}. A dash: the log does not tell. Our readings are more than the published ones, "
        "since hiding needs distance and facing."
    )


def _map(outcome: Outcome, refusal: BlockRobotError | None, drawn: str | None) -> str:
    assert outcome.reading is not None
    graph = outcome.reading.graph
    note = ""
    if refusal is not None:
        note = quiet(
            f"Graphviz drew no map here ({text(refusal.code)}); this is the plainer one of our own. "
            f"Next step: {text(refusal.next_step)}"
        )
    alternative = (
        f"Process map: {len(graph.activities)} activities and the {len(graph.pairs)} ways from one to the next. "
        "The tables under Statistics say the same in figures."
    )
    drawing_html = drawing(drawn or draw_svg(graph), name="Process map", alternative=alternative)
    return (
        "<p>Each arrow: how often the second came directly after the first in the same frame (for the same owner), and "
        f"how long after on average.</p>{drawing_html}{note}"
    )


def _pictures(outcome: Outcome) -> str:
    shown = []
    for alias, belongings in outcome.belongings.items():
        step = max(1, len(belongings.pictures) // PICTURES_A_PERSON_COUNT)
        shown += [_figure(alias, path) for path in belongings.pictures[::step][:PICTURES_A_PERSON_COUNT]]
    return gallery(shown) if shown else "<p>Nobody has a picture.</p>"


def _figure(alias: str, path: Path) -> str:
    label = f"{name_person(alias)}, frame {read_robot_frame(path.name)}"
    alternative = f"{label}: one silhouette and nobody else, distance in colours"
    return picture(path.read_bytes(), alternative=alternative, caption=label)


def _statistics(outcome: Outcome) -> str:
    assert outcome.reading is not None
    graph = outcome.reading.graph
    return (
        f"<p>{graph.event_count:,} events in {graph.case_count:,} cases: a frame is a case, and so are a tag's readings. "
        "An activity's duration is the time since the event before in its case.</p>"
        + _rows("Each activity (times in ms)", "Activity", activity_rows(graph))
        + _rows("Each pair, the second directly after the first (times in ms)", "Pair of activities", pair_rows(graph))
    )


def _rows(caption: str, heading: str, rows: Sequence[Row]) -> str:
    # Activities have long names; on paper they may break behind an underscore.
    cells = [[text(row.name).replace("_", "_<wbr>"), *map(show_value, row.values)] for row in rows]
    return table(caption, [heading, *HEADINGS], cells)

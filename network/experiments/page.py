"""The page of an experiment: one file that reads from the question to the answer. Must never show a key, a handle or a tag.

What was asked and what held; what share was paired, where time goes, what was lost, each beside the published run; the
process map; what people see; the statistics tables.
"""

from __future__ import annotations

import base64
import html
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from consensus.errors import BlockRobotError
from network.demo.checks import Check
from network.experiments.picture import draw_svg
from network.experiments.published_figures import SOURCE
from network.experiments.run_figures import RunFigures
from network.experiments.run_one import Outcome
from network.experiments.tables import HEADINGS, Row, activity_rows, figure_rows, pair_rows, show_value

PICTURES_A_PERSON_COUNT = 3
_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; max-width: 68rem; margin: 2rem auto; padding: 0 1rem; color: #222; }
h1 { font-size: 1.6rem; } h2 { margin-top: 2.5rem; font-size: 1.2rem; } .wide { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; } td, th { padding: .3rem .6rem; border-bottom: 1px solid #ddd; }
td, th { text-align: left; vertical-align: top; } td.n, th.n { text-align: right; white-space: nowrap; }
.held { color: #0a6b2d; } .failed { color: #b00020; font-weight: bold; } .small { font-size: .85rem; color: #555; }
.bar { display: inline-block; height: .9rem; background: #3b6ea5; vertical-align: middle; }
.bar.other { background: #c48a3a; }
figure { display: inline-block; margin: .5rem; } figure img { width: 20rem; max-width: 100%; }
figcaption { font-size: .85rem; } svg { max-width: 100%; height: auto; }
"""


def _html(title: str, body: str) -> str:
    return (
        f"<!doctype html>\n<html lang=en><meta charset=utf-8><title>{html.escape(title)}</title>"
        f"<style>{_STYLE}</style><h1>{html.escape(title)}</h1>{body}</html>\n"
    )


def _table(headings: Sequence[str], rows: Sequence[Sequence[str]], *, numbers_from: int = 1) -> str:
    """Return a table of cells that are HTML already; columns from `numbers_from` on are set to the right."""
    mark = ["" if place < numbers_from else " class=n" for place in range(len(headings))]
    head = "".join(f"<th{kind}>{cell}</th>" for kind, cell in zip(mark, headings, strict=True))
    lines = ["".join(f"<td{kind}>{cell}</td>" for kind, cell in zip(mark, row, strict=True)) for row in rows]
    return f"<div class=wide><table><tr>{head}</tr>" + "".join(f"<tr>{line}</tr>" for line in lines) + "</table></div>"


def build_page(outcome: Outcome, refusal: BlockRobotError | None) -> str:
    """Return an experiment's page. `refusal` says why Graphviz drew no map, if it did not."""
    experiment = outcome.experiment
    parts = [f"<p>{html.escape(experiment.question)}</p>", _verdict(outcome), _conditions(outcome.conditions)]
    parts.append("<h2>What was checked</h2>")
    parts.append(_checks(outcome.checks.checks))
    if outcome.reading is not None:
        figures = outcome.reading.figures
        parts += ["<h2>What share was paired</h2>", _paired(outcome, figures)]
        parts += ["<h2>Where the time goes</h2>", _times(outcome, figures)]
        parts += ["<h2>What was lost</h2>", _lost(outcome, figures)]
        parts += [f"<h2>Beside {html.escape(experiment.beside.name)}</h2>", _side_by_side(outcome, figures)]
        parts += ["<h2>What follows what</h2>", _map(outcome, refusal)]
        parts += ["<h2>What people see</h2>", _pictures(outcome)]
        parts += ["<h2>Statistics</h2>", _statistics(outcome)]
    return _html(f"Experiment {experiment.number}: {experiment.title}", "".join(parts))


def build_index(outcomes: Sequence[Outcome], result: dict[str, Any]) -> str:
    """Return the page over all experiments of a run."""
    rows = []
    for outcome in outcomes:
        held = sum(check.ok for check in outcome.checks.checks)
        frames = outcome.robot.get("frames", {})
        name = outcome.experiment.name
        rows.append(
            [
                f"<a href='{name}/report.html'>{outcome.experiment.number}: {html.escape(outcome.experiment.title)}</a>",
                "<span class=held>held</span>" if outcome.ok else "<span class=failed>FAILED</span>",
                f"{held} of {len(outcome.checks.checks)}",
                *(f"{frames.get(key, 0):,}" for key in ("published", "covered", "kept", "withheld", "lost")),
            ]
        )
    headings = ["Experiment", "Claims", "Checks", "Frames", "Covered", "Kept", "Withheld", "Lost"]
    conditions = ", ".join(f"{key} {value}" for key, value in result["conditions"].items() if key != "scenarios")
    note = (
        "<p class=small>Covered, kept, withheld and lost count a frame once for each owner. "
        f"{result['figures']['seconds']} s in all; {html.escape(conditions)}.</p>"
    )
    return _html("The experiments", _table(headings, rows, numbers_from=2) + note)


def _conditions(conditions: dict[str, Any]) -> str:
    told = ", ".join(f"{key} {value}" for key, value in conditions.items() if value is not None)
    return (
        f"<p class=small>Measured with: {html.escape(told)}. A load above the cores means that others worked too.</p>"
    )


def _verdict(outcome: Outcome) -> str:
    if outcome.ok:
        return "<p class=held>Every check held.</p>"
    return "<p class=failed>Not every check held.</p>"


def _checks(checks: Sequence[Check]) -> str:
    marks = {True: "<span class=held>held</span>", False: "<span class=failed>FAILED</span>"}
    rows = [[marks[check.ok], html.escape(check.name), html.escape(check.detail)] for check in checks]
    return _table(["", "Check", "Seen"], rows, numbers_from=3)


def _percent(part: float, whole: float) -> str:
    return f"{100 * part / whole:.1f} %" if whole else "0 %"


def _paired(outcome: Outcome, figures: RunFigures) -> str:
    theirs = outcome.experiment.beside.figures
    frames = outcome.robot["frames"]
    received, covered = theirs["frames received"], theirs["frames received within 5 s of a reading, by arrival"]
    return (
        f"<p>{figures.frames_received:,} frames were received. {figures.frames_covered:,} of them "
        f"({_percent(figures.frames_covered, figures.frames_received)}) arrived within five seconds of a tag's reading. "
        f"Pairing goes by when a frame was taken, not by when it arrived: {figures.frames_paired:,} were paired with a "
        f"registered tag, which makes {frames['covered']:,} frames and owners, since a frame belongs to everybody whose "
        f"tag was near. Of these, {frames['kept']:,} "
        f"({_percent(frames['kept'], frames['covered'])}) are on the chain, and {frames['withheld']:,} were withheld.</p>"
        f"<p>The prototype received {received:,.0f} frames, {covered:,.0f} of them within five seconds of a reading, and "
        f"paired {theirs['frames paired']:,.0f} ({_percent(theirs['frames paired'], received)})."
        f"{html.escape(outcome.experiment.beside.remark)}</p>"
    )


def _times(outcome: Outcome, figures: RunFigures) -> str:
    theirs = outcome.experiment.beside.figures
    rows = []
    ways = [("received to paired", "received to paired"), ("paired to on the chain", "paired to on the chain")]
    ways.append(("received to on the chain", "received to on the chain"))
    longest = max(
        [figures.stretches[name].mean_ms for name, _ in ways] + [theirs[f"{name}, mean (ms)"] for name, _ in ways]
    )
    for name, _ in ways:
        ours, other = figures.stretches[name].mean_ms, theirs[f"{name}, mean (ms)"]
        rows.append([name, _bar(ours, longest), f"{ours:,.0f} ms", _bar(other, longest, "other"), f"{other:,.0f} ms"])
    latency = outcome.robot["latency_ms"]
    window = latency["frame_to_final"]
    return (
        "<p>A frame is paired when nothing that may still arrive can change its owners: five seconds for readings to "
        "come, one for those that come late. That wait is most of the way, and it is chosen. The prototype paired at "
        "once, with what it had. Ours is on the chain when it is final, by a quorum; theirs when one producer took it.</p>"
        + _table(["Mean", "ours", "", "theirs", ""], rows, numbers_from=5)
        + f"<p>From the end of the five seconds to final: median {window['p50']:,.0f} ms, 95 in 100 within "
        f"{window['p95']:,.0f} ms, at most {window['max']:,.0f} ms (longer where whom a silhouette belongs to was settled "
        f"only by later readings). From submission to final: median {latency['submit_to_final']['p50']:,.0f} ms.</p>"
    )


def _bar(value: float, longest: float, kind: str = "") -> str:
    width = 12 * value / longest if longest else 0
    return f"<span class='bar {kind}' style='width:{width:.2f}rem'></span>"


def _lost(outcome: Outcome, figures: RunFigures) -> str:
    theirs = outcome.experiment.beside.figures
    frames = outcome.robot["frames"]
    reasons = ", ".join(f"{html.escape(name)} {count:,}" for name, count in frames["withheld_reasons"].items())
    return (
        f"<p>{figures.frames_published - figures.frames_received:,} of {figures.frames_published:,} frames did not arrive; "
        f"of those that had an owner, {frames['lost']:,} were lost. The prototype lost "
        f"{theirs['frames lost before they arrived (%)']:.1f} % of its frames before they arrived.</p>"
        f"<p>Withheld is not lost: who cannot be shown alone is not shown, and her wallet tells her so with the reason. "
        f"Here: {reasons or 'none'}. (no-silhouette: she was not to be seen; ambiguous: it could not be settled which "
        "silhouette was hers; contact, merged, occluded: somebody was too near or in front.) The prototype gave "
        "everybody the whole frame, the others included.</p>"
    )


def _side_by_side(outcome: Outcome, figures: RunFigures) -> str:
    theirs = outcome.experiment.beside.figures
    rows = [
        [html.escape(name), show_value(value), show_value(theirs.get(name))] for name, value in figure_rows(figures)
    ]
    return (
        _table(["", "ours", "theirs"], rows)
        + f"<p class=small>Theirs: {html.escape(SOURCE)}. A dash: the log does not tell. Our readings are more than the "
        "published ones, since hiding needs distance and facing; the frames that they cover are not.</p>"
    )


def _map(outcome: Outcome, refusal: BlockRobotError | None) -> str:
    assert outcome.reading is not None
    note = ""
    if refusal is not None:
        note = (
            f"<p class=small>Graphviz drew no map here ({html.escape(refusal.code)}). "
            f"Next step: {html.escape(refusal.next_step)}</p>"
        )
    return (
        "<p>Each arrow: how often the second came directly after the first in the same frame (for the same owner), and "
        f"how long after on average.</p><div class=wide>{draw_svg(outcome.reading.graph)}</div>{note}"
    )


def _pictures(outcome: Outcome) -> str:
    shown = []
    for alias, belongings in outcome.belongings.items():
        step = max(1, len(belongings.pictures) // PICTURES_A_PERSON_COUNT)
        shown += [_figure(alias, picture) for picture in belongings.pictures[::step][:PICTURES_A_PERSON_COUNT]]
    return "".join(shown) or "<p>Nobody has a picture.</p>"


def _figure(alias: str, picture: Path) -> str:
    data = base64.b64encode(picture.read_bytes()).decode()
    label = html.escape(f"{alias.replace('-', ' ')}, frame {int(picture.stem)}")
    image = f"<img alt='{label}' src='data:image/png;base64,{data}'>"
    return f"<figure>{image}<figcaption>{label}</figcaption></figure>"


def _statistics(outcome: Outcome) -> str:
    assert outcome.reading is not None
    graph = outcome.reading.graph
    return (
        f"<p>{graph.event_count:,} events in {graph.case_count:,} cases: a frame is a case, and so are a tag's readings. "
        "An activity's duration is the time since the event before in its case.</p>"
        + _rows("Activity", activity_rows(graph))
        + _rows("Pair of activities", pair_rows(graph))
    )


def _rows(heading: str, rows: Sequence[Row]) -> str:
    cells = [[html.escape(row.name), *map(show_value, row.values)] for row in rows]
    return _table([heading, *HEADINGS], cells)

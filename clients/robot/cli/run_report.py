"""A run's report: summary, obstacles, what an interruption leaves."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from typing import TypeVar

from msgspec import UnsetType

from clients.robot.cli.robot_choice import ROBOT_COMMAND, name_robot
from clients.robot.consent.consent_view import ConsentCounts
from clients.robot.hiding.moving.driving_figures import NO_FLOOR, DrivingFigures
from clients.robot.hiding.withhold_reason import MergedBy, WithholdReason
from clients.robot.matching.match_evidence import Obstacle
from clients.robot.pairing.rosters import UnknownTagCounts
from clients.robot.recording.frame_answers import AmbiguousTag, FrameCounts, MergedTag
from clients.robot.run.run_summary import RunIntake, RunProgress, RunSummary
from clients.robot.sensing.camera_intrinsics import ASSUMED, FOCAL_DEFAULT_PX, CameraFigures
from clients.robot.sensing.input_checks import KIND_WORDS, RunFault
from clients.sdk.terminal.safe_output import overwrite_line
from consensus.errors import BlockRobotError

AMBIGUOUS_LINES_MAX_COUNT = 3
REASON_WORDS = {
    "encoding": "of an encoding that is not read",
    "size": "of a wrong size",
    "step": "width, height, step and length contradict each other",
    "undecodable": "damaged, or of another type than they say",
    "field": "a field that the topics file names is not there, or holds something else",
    "json": "no JSON where JSON should be, or the other way round",
    "tag": "without a tag, or with one that is too long",
    "time": "a reading ends before it begins, or lasts too long",
    "frame": "of another frame of reference than the topics file names",
    "type": "of another type than the topics file needs",
    "unknown-type": "of a type that nobody defines",
}
"""What it means that a message was refused for a reason."""

C = TypeVar("C")


def clear_line() -> None:
    if sys.stderr.isatty():
        overwrite_line()


def summary_lines(summary: RunSummary, silent: Sequence[str] = ()) -> Iterator[str]:
    """`silent` are the topics of tags, if no reading came of any."""
    frames = summary.frames
    is_any_kept = frames.kept or any(counts.kept for counts in summary.senses.values())
    kept = f"{frames.kept} kept" + (f" in {_count_of(summary.records, 'record')}" if is_any_kept else "")
    published = _count_of(frames.published, "frame")
    line = f"{published}; counted for each owner: {kept}, {_withheld(frames)}, {frames.lost} lost."
    if summary.records and not is_any_kept:
        says = "says" if summary.records == 1 else "say"
        line += f" {_count_of(summary.records, 'record')} {says} what was withheld."
    yield line
    if frames.published and not frames.kept:
        if silent:
            yield f"No reading of a tag came: 0 messages of {', '.join(silent)}."
        elif not frames.withheld:
            yield "No frame was in reach of a reading of a tag on the roster."
        yield "No frame was kept. What each reason means: docs/how-to/your-robot.md, `What is kept, and what is withheld`."
    camera = summary.camera
    is_guessed = camera.focal_from == ASSUMED
    yield from _ambiguous_lines(summary.ambiguous, is_guessed=is_guessed)
    yield from _merged_lines(summary.merged)
    for row in summary.distances_off[:AMBIGUOUS_LINES_MAX_COUNT]:
        yield (
            f"{row.alias}, {row.frames} kept: its distances are on average {row.gap_m:+.2f} m off the camera's "
            f"(stated error {row.sigma_m:.2f} m; they differ from that by {row.spread_m:.2f} m, one by one). Was the "
            "right person shown? Check distance_unit, distance_sigma, from where the reader measures, and the clocks"
            f"{_guess_words(is_guessed)}."
        )
    for sensor, counts in summary.senses.items():
        yield (f"{counts.published} of {sensor}: {counts.kept} kept, {_withheld(counts)}, {counts.lost} lost.")
    intake = summary.intake
    yield from refused_lines(summary.uploads_refused)
    yield from _unknown_lines(intake.unknown_tags)
    yield from consent_lines(summary.consents)
    for kind, reasons in intake.messages_refused.items():
        listed = "; ".join(f"{count} {reason}: {REASON_WORDS.get(reason, reason)}" for reason, count in reasons.items())
        first = intake.first_refused.get(kind)
        line = f"Not usable: {sum(reasons.values())} {KIND_WORDS[kind]} ({listed})."
        yield f"{line} The first: {first}" if first else line
        if "json" in reasons:
            yield 'A field holds JSON text: name the value in it in the topics file, as in epc = "data{}.uid".'
    yield from _antenna_lines(_counts(intake.antennas_unnamed))
    yield from _live_lines(intake)
    yield from _focal_lines(camera)
    yield from _driving_lines(summary.driving, frames.withheld_reasons.get(WithholdReason.MOVED, 0))


def _counts(found: dict[str, C] | UnsetType) -> dict[str, C]:
    return {} if isinstance(found, UnsetType) else found


def _antenna_lines(unnamed: dict[str, dict[str, int]]) -> Iterator[str]:
    for topic, counts in unnamed.items():
        heard = ", ".join(f"{name} ({count} times)" for name, count in counts.items())
        yield (
            f"Antennas heard on {topic} that its front and back do not name: {heard}. Name them there: of such readings it "
            "is not known which way their antenna looks."
        )


def _guess_words(is_guessed: bool) -> str:
    return f"; and focal_px: {FOCAL_DEFAULT_PX:g} pixels are a guess" if is_guessed else ""


def _ambiguous_lines(rows: list[AmbiguousTag], *, is_guessed: bool) -> Iterator[str]:
    for row in rows[:AMBIGUOUS_LINES_MAX_COUNT]:
        spread = f"they differ from that by {row.spread_m:.2f} m, one by one"
        delay = (
            ""
            if isinstance(row.delay_ms, UnsetType)
            else f"about {abs(row.delay_ms) / 1000:g} s {'late' if row.delay_ms > 0 else 'early'}: "
        )
        rival = "" if isinstance(row.rival_log_odds, UnsetType) else f", the next person {row.rival_log_odds:g}"
        yield (
            f"{row.alias}, {row.frames} ambiguous: log-odds {row.log_odds:g} of {row.needed:g} needed{rival}; "
            f"{row.distances} distances, on average {row.gap_m:+.2f} m off the camera's (stated error "
            f"{row.sigma_m:.2f} m; {spread}); {row.front} readings in front, {row.back} behind: "
            f"{delay}{row.help}{_guess_words(is_guessed and row.obstacle == Obstacle.OFF)}."
        )
    if len(rows) > AMBIGUOUS_LINES_MAX_COUNT:
        yield f"{len(rows) - AMBIGUOUS_LINES_MAX_COUNT} more tags have ambiguous frames; --json lists them."


def _merged_lines(rows: list[MergedTag]) -> Iterator[str]:
    for row in rows[:AMBIGUOUS_LINES_MAX_COUNT]:
        limit = {
            MergedBy.AREA: f"{row.limit:g} m² is the limit",
            MergedBy.BREADTH: f"{row.limit:g} m of breadth is the limit",
        }.get(MergedBy(row.by), f"log-odds of two people {row.log_odds:g}, {row.limit:g} is the limit")
        yield (
            f"{row.alias}, {row.frames} merged: {row.area_m2:g} m² of silhouette, {row.breadth_m:g} m broad, "
            f"{row.range_m:g} m away; {limit}: {row.help}."
        )
    if len(rows) > AMBIGUOUS_LINES_MAX_COUNT:
        yield f"{len(rows) - AMBIGUOUS_LINES_MAX_COUNT} more tags have merged frames; --json lists them."


def refused_lines(refused: dict[str, int]) -> Iterator[str]:
    if refused:
        listed = ", ".join(f"{count} {code}" for code, count in refused.items())
        yield f"Custodians took no upload {sum(refused.values())} times ({listed}); what was refused was tried again."


def _count_of(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def _withheld(counts: FrameCounts) -> str:
    reasons = counts.withheld_reasons
    listed = [f"{count} {reason}" for reason, count in reasons.items()] if len(reasons) > 1 else list(reasons)
    return f"{counts.withheld} withheld" + (f" ({', '.join(listed)})" if listed else "")


def _live_lines(intake: RunIntake) -> Iterator[str]:
    for kind, count in _counts(intake.missed).items():
        yield f"Not read: {count} {KIND_WORDS[kind]} came while there was no room for them; this machine is too slow."
    for topic, count in _counts(intake.never_came).items():
        yield f"Never came: {count} messages of {topic}, lost between the robot's middleware and here."
    for kind, count in _counts(intake.unread).items():
        yield f"Not read: {count} {KIND_WORDS[kind]} had just come when the run ended."
    for topic, count in _counts(intake.gone).items():
        yield f"Gone {count} {'time' if count == 1 else 'times'} for a while: {topic}."


def _focal_lines(camera: CameraFigures) -> Iterator[str]:
    count = camera.frames_before
    if count and camera.focal_from == ASSUMED:
        yield (
            f"No focal length is known: {camera.focal_px:g} pixels were assumed, and people's sizes are wrong by as "
            "much as that is. Publish CameraInfo beside the depth topic, or write focal_px into the topics file."
        )
    elif count:
        yield (
            f"The focal length ({camera.focal_px:g} pixels) came late: before that {count} frames were measured by "
            f"{FOCAL_DEFAULT_PX:g}."
        )


_ONLY_AT_HOME = "Away from where the empty scene was recorded, its camera cannot tell that, as set up in this run. "


def _driving_lines(driving: DrivingFigures | None, moved: int) -> Iterator[str]:
    if driving is not None and not driving.places:
        yield (
            "No place of odometry came, so nobody was kept at all: a tag is bound only while odometry says that the robot "
            "stands. Is the topic right?"
        )
        return
    if driving is not None and driving.unplaced_readings:
        yield (
            f"{_count_of(driving.unplaced_readings, 'reading')} bound nobody: it was not known in time whether the robot "
            f"stood then. {'' if driving.camera_height_m is not None else _ONLY_AT_HOME}It takes a place of odometry every "
            "quarter of a second."
        )
    if driving is not None and driving.home_lost:
        yield (
            "From some time on the empty scene was no longer used, as the robot might have been elsewhere: its odometry "
            "broke off or jumped away from there, or the camera's clock began anew. A run that begins there uses it again."
        )
    if driving is not None and driving.keep:
        yield from _keeping_lines(driving)
    elif moved:
        yield (
            f"{_count_of(moved, 'frame')} withheld: the robot was not where the empty scene was recorded. What "
            "could be kept of a robot that drives: docs/how-to/your-robot.md, `A robot that drives`."
        )


def _keeping_lines(driving: DrivingFigures) -> Iterator[str]:
    if driving.camera_height_m is None:
        yield NO_FLOOR
        return
    yield (
        f"Without the empty scene (as while it drove): {_count_of(driving.frames, 'frame')}, {driving.kept} kept, which "
        f"show their owner without the room. {_count_of(driving.places, 'place')} of odometry; the camera is "
        f"{driving.camera_height_m:.2f} m above the floor and looks {_pitch_of(driving)}."
    )
    if driving.doubts:
        yield (
            f"{_count_of(driving.doubts, 'time')} the camera saw another motion than the odometry told, and nothing was "
            "kept meanwhile: do the wheels slip, or was the robot pushed?"
        )


def _pitch_of(driving: DrivingFigures) -> str:
    pitch_deg = round(driving.camera_pitch_deg or 0.0)
    return f"{abs(pitch_deg)} degrees {'down' if pitch_deg >= 0 else 'up'}"


def _unknown_lines(unknown: UnknownTagCounts) -> Iterator[str]:
    if not unknown.readings:
        return
    tags = "a tag that is" if unknown.tags == 1 else f"{unknown.tags} tags that are"
    more = "more than " if unknown.more_tags else ""
    yield (
        f"Readings of {more}{tags} not on the roster: {unknown.readings}; nothing is kept for them. Is one of them a "
        "participant's? Then its card must be issued for the UID as the reader tells it (only upper and lower case do not "
        "matter), and the roster made again after that."
    )


def consent_lines(figures: ConsentCounts) -> Iterator[str]:
    if figures.stale_times:
        seconds = round(figures.stale_ms / 1000)
        yield f"For {seconds} s nobody's consent could be proved, and nothing was kept meanwhile. Is the network in reach?"
    refused = figures.sightings_refused
    if refused.get("no-consent"):
        yield f"{refused['no-consent']} readings were of tags whose bearers do not consent to this purpose and sensor."
    if refused.get("consent-coming"):
        yield (
            f"{refused['consent-coming']} readings were of tags whose bearers' consent had not begun: one that was just "
            "given counts from the chain's next block on, which an idle network makes within a minute."
        )
    if figures.clips_dropped:
        yield f"{figures.clips_dropped} sealed clips were destroyed: consent to them had ended."


def broken_off(fault: RunFault) -> BlockRobotError:
    return BlockRobotError(fault.code, fault.detail + " What came before it is recorded.")


def ending_line(figures: RunProgress) -> str:
    return (
        f"\nEnding. So far {_so_far(figures)}. What is in memory is now sealed and recorded too, and visits are closed. "
        "Once more (Ctrl-C) ends it at once."
    )


def ended_line() -> str:
    return "Ended as you asked: all that was seen until then is settled, nothing waits in the spool, visits are closed."


def waiting_line(waiting_count: int) -> str:
    clips = "1 sealed clip waits" if waiting_count == 1 else f"{waiting_count} sealed clips wait"
    return f"{clips} from a run before: recorded first, and counted among this run's records."


def broken_line(figures: RunProgress, waiting_count: int, spool: str, *, is_live: bool) -> str:
    again = name_robot(f"with `{ROBOT_COMMAND} run` as before") if is_live else "with any recording"
    waits = f"{waiting_count} sealed clips wait in {spool}" if waiting_count else "No sealed clip waits"
    return (
        f"Ended at once. {_so_far(figures).capitalize()}. {waits}; what was only in memory is lost.\n"
        f"To go on, start the robot again {again}: it first records what waits, each clip once, and closes "
        "the visits that are open."
    )


def _so_far(figures: RunProgress) -> str:
    read, kept, records = figures.frames_read or 0, figures.frames_recorded or 0, figures.records or 0
    were, are = "was" if read == 1 else "were", "is" if kept == 1 else "are"
    return (
        f"{_count_of(read, 'frame')} {were} read; {kept}, counted for each owner, {are} recorded in "
        f"{_count_of(records, 'record')}"
    )

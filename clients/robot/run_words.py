"""What a run says of itself to a person: its summary, what stood in the way, and what is left when it is broken off.

Must never name a person, a tag, a handle or a key: counts only.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any

from clients.robot.hiding.hider import FOCAL_DEFAULT_PX
from clients.robot.lens import ASSUMED
from consensus.errors import BlockRobotError


def clear_line() -> str:
    """Return what empties the line on which a run's progress stands, if standard error is a terminal."""
    return "\r\x1b[K" if sys.stderr.isatty() else ""


def summary_lines(summary: dict[str, Any]) -> Iterator[str]:
    """Yield the lines that tell what became of everything that came."""
    frames = summary["frames"]
    yield (
        f"{frames['published']} frames: {frames['kept']} kept in {summary['records']} records, "
        f"{_withheld(frames)}, {frames['lost']} lost."
    )
    if frames["withheld"] and not frames["kept"]:
        yield "No frame was kept. What each reason means: docs/how-to/your-robot.md, `What is kept, and what is withheld`."
    for sensor, counts in summary["senses"].items():
        yield (f"{counts['published']} of {sensor}: {counts['kept']} kept, {_withheld(counts)}, {counts['lost']} lost.")
    intake = summary["intake"]
    yield from _unknown_lines(intake["unknown_tags"])
    yield from consent_lines(summary["consents"])
    for kind, reasons in intake["messages_refused"].items():
        told = ", ".join(f"{count} for {reason}" for reason, count in reasons.items())
        yield f"Not usable: {sum(reasons.values())} of kind {kind} ({told})."
    yield from _live_lines(intake)
    yield from _focal_lines(summary.get("camera", {}))


def _withheld(counts: dict[str, Any]) -> str:
    """Return how many were withheld, and why; the number of each reason only where there are several."""
    reasons = counts.get("withheld_reasons", {})
    told = [f"{count} {reason}" for reason, count in reasons.items()] if len(reasons) > 1 else list(reasons)
    return f"{counts['withheld']} withheld" + (f" ({', '.join(told)})" if told else "")


def _live_lines(intake: dict[str, Any]) -> Iterator[str]:
    """Yield what a live run did not get to, and what was gone for a while."""
    for kind, count in intake.get("missed", {}).items():
        yield f"Not read: {count} messages of kind {kind} came while there was no room for them; this machine is too slow."
    for topic, count in intake.get("never_came", {}).items():
        yield f"Never came: {count} messages of {topic}, lost between the robot's middleware and here."
    for kind, count in intake.get("unread", {}).items():
        yield f"Not read: {count} messages of kind {kind} had just come when the run ended."
    for topic, count in intake.get("gone", {}).items():
        yield f"Gone {count} {'time' if count == 1 else 'times'} for a while: {topic}."


def _focal_lines(camera: dict[str, Any]) -> Iterator[str]:
    """Yield by what guess people were measured, if by one."""
    count = camera.get("frames_before", 0)
    if count and camera["focal_from"] == ASSUMED:
        yield (
            f"No focal length is known: {camera['focal_px']:g} pixels were assumed, and people's sizes are wrong by as "
            "much as that is. Publish CameraInfo beside the depth topic, or write focal_px into the topics file."
        )
    elif count:
        yield (
            f"The focal length ({camera['focal_px']:g} pixels) came late: before that {count} frames were measured by "
            f"{FOCAL_DEFAULT_PX:g}."
        )


def _unknown_lines(unknown: dict[str, Any]) -> Iterator[str]:
    if not unknown["readings"]:
        return
    tags = "a tag that is" if unknown["tags"] == 1 else f"{unknown['tags']} tags that are"
    more = "more than " if unknown["more_tags"] else ""
    yield (
        f"Readings of {more}{tags} not on the roster: {unknown['readings']}; nothing is kept for them. Is one of them a "
        "participant's? Then its card must be issued for the UID exactly as the reader tells it, and the roster made "
        "again after that."
    )


def consent_lines(figures: dict[str, Any]) -> Iterator[str]:
    """Yield where consent stood in the way of recording, if it did."""
    if figures["stale_times"]:
        seconds = round(figures["stale_ms"] / 1000)
        yield f"For {seconds} s nobody's consent could be proved, and nothing was kept. Is the network in reach?"
    refused = figures["sightings_refused"]
    if refused.get("no-consent"):
        yield f"{refused['no-consent']} readings were of tags whose bearers do not consent to this purpose and sensor."
    if refused.get("consent-coming"):
        yield (
            f"{refused['consent-coming']} readings were of tags whose bearers' consent had not begun: one that was just "
            "given counts from the chain's next block on, which an idle network makes within a minute."
        )
    if figures["clips_dropped"]:
        yield f"{figures['clips_dropped']} sealed clips were destroyed: consent to them had ended."


def broken_off(fault: dict[str, str]) -> BlockRobotError:
    """Return the error of a recording that broke off."""
    return BlockRobotError(fault["code"], fault["detail"] + " What came before it is recorded.")


def ending_line(figures: dict[str, Any]) -> str:
    """Return what to say when the user ends a run in good order; `figures` are those of its progress so far."""
    return (
        f"\nEnding. So far {_so_far(figures)}. What is in memory is now sealed and recorded too, and visits are closed. "
        "Once more (Ctrl-C) ends it at once."
    )


def ended_line() -> str:
    """Return what to say when a run that its user ended is over."""
    return "Ended as you asked: all that was seen until then is settled, nothing waits in the spool, visits are closed."


def waiting_line(waiting_count: int) -> str:
    """Return what to say at the start of a run that finds clips in the spool."""
    clips = "1 sealed clip waits" if waiting_count == 1 else f"{waiting_count} sealed clips wait"
    return f"{clips} from a run before: recorded first, and counted among this run's records."


def broken_line(figures: dict[str, Any], waiting_count: int, spool: str, *, is_live: bool) -> str:
    """Return what to say when the user ended a run at once: what was kept, what waits, and how to go on."""
    again = "with `blockrobot robot run` as before" if is_live else "with any recording"
    waits = f"{waiting_count} sealed clips wait in {spool}" if waiting_count else "No sealed clip waits"
    return (
        f"{clear_line()}Ended at once. {_so_far(figures).capitalize()}. {waits}; what was only in memory is lost.\n"
        f"To go on, start the robot again {again}: it first records what waits, each clip once, and closes "
        "the visits that are open."
    )


def _so_far(figures: dict[str, Any]) -> str:
    """Return how far a run is. Frames are counted once for each of their owners."""
    kept, records = figures.get("frames_recorded", 0), figures.get("records", 0)
    return f"{figures.get('frames_read', 0)} frames were read, and {kept} are recorded in {records} records"

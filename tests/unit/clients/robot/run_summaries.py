"""Summaries of runs in which all is well, to begin from."""

from __future__ import annotations

from typing import Any

from msgspec.structs import replace

from clients.robot.consent.consent_view import ConsentFigures
from clients.robot.pairing.input_throttle import InputThrottle
from clients.robot.pairing.rosters import UnknownTags
from clients.robot.pairing.tag_pairing import Pairing
from clients.robot.recording.frame_answers import FrameCounts
from clients.robot.recording.run_statistics import RunStatistics
from clients.robot.run.run_summary import RunIntake, RunSummary
from clients.robot.sensing.camera_intrinsics import CameraFigures
from clients.sdk.terminal.json_answers import extend

FRAMES = FrameCounts(published=6, covered=6, kept=6, withheld=0, withheld_reasons={}, lost=0)


def summary_of(frames: FrameCounts, **intake: Any) -> RunSummary:
    """Return the summary of a run with these frames; `intake`: fields of its intake that differ."""
    pipeline = InputThrottle().summarise(Pairing(), UnknownTags())
    intake = {"messages_refused": {}, "first_refused": {}, "fault": None, **intake}
    unknown = intake.pop("unknown_tags", pipeline.unknown_tags)
    statistics = RunStatistics(window_ms=500)
    return RunSummary(
        roster_rows=1,
        consents=ConsentFigures().summarise(),
        frames=frames,
        ambiguous=[],
        merged=[],
        distances_off=[],
        senses={},
        latency_ms=statistics.summarise_latencies(),
        hiding_ms=statistics.hiding.summarise(),
        intake=extend(RunIntake, replace(pipeline, unknown_tags=unknown), **intake),
        driving=None,
        camera=CameraFigures(focal_px=525.0, focal_from="topics", frames_before=0),
        records=1,
        stored_bytes=1_000,
        spool_peak_bytes=1_000,
        uploads_refused={},
        final_gap_max_s=0.5,
    )

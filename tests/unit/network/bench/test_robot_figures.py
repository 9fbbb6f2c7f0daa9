"""The figures of `bench robot`: good only if owners found every kept frame once."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from msgspec import UNSET
from msgspec.structs import replace

from clients.robot.hiding.moving.driving_figures import DrivingFigures
from clients.robot.recording.frame_answers import FrameCounts, Latency
from clients.sdk.terminal.json_answers import extend
from network.bench.robot.robot_bench import RobotFigures, RobotOptions, is_good, make_figures
from network.bench.robot.robot_counts import LoggedFrames, Timed
from network.bench.robot.robot_owners import OwnFrames
from network.bench.robot.robot_player import PlayedSummary, ProcessCost, read_peak_bytes
from tests.unit.clients.robot.run_summaries import summary_of

ROBOT = b"\x02" * 33
OPTIONS = RobotOptions(seconds=0.5, robots=1, fps=4, cut_s=0.0, seed=1, cache=Path("nowhere"))


def summary(**frames: int) -> PlayedSummary:
    counts = {"published": 2, "covered": 3, "kept": 2, "withheld": 1, "lost": 0, **frames}
    told = summary_of(FrameCounts(**counts, withheld_reasons={"contact": counts["withheld"]}))
    latencies = replace(told.latency_ms, submit_to_final=Latency(p50=20.0, p95=30.0, max=40.0))
    told = replace(told, hiding_ms=Latency(p50=7.5, p95=9.5, max=20.0))
    told = replace(told, records=2, stored_bytes=3_000, spool_peak_bytes=4_000, latency_ms=latencies)
    return extend(PlayedSummary, told, process=ProcessCost(cpu_s=1.0, seconds=4.0, rss_peak_bytes=100 * 1024 * 1024))


def logged() -> LoggedFrames:
    return LoggedFrames(
        paired={"tag-a": Counter([0, 1]), "tag-b": Counter([1])},
        kept={"tag-a": Counter([0]), "tag-b": Counter([1])},
        withheld={"tag-a": Counter([1])},
        times=[Timed(100, 300), Timed(100, 700)],
        taken_at_ms=[0, 250],
    )


def owners() -> list[OwnFrames]:
    return [OwnFrames(frames={ROBOT: Counter([number])}, record_count=1) for number in (0, 1)]


def figures(found: list[OwnFrames], **frames: int) -> RobotFigures:
    return make_figures(OPTIONS, [(ROBOT, summary(**frames), logged())], found, {})


def test_a_run_in_which_owners_found_all_is_good() -> None:
    found = figures(owners())
    assert is_good(found)
    assert (found.frame_to_final_p50_ms, found.frame_to_final_p95_ms) == (200, 600)
    assert (found.rss_peak_mb, found.robot_cpu_share, found.stored_bytes_per_frame) == (100.0, 0.25, 1_500)
    assert (found.submit_to_final_p95_ms, found.frames_per_s) == (30.0, 4.0)
    assert (found.hiding_p50_ms, found.hiding_p95_ms) == (7.5, 9.5)
    assert found.frames_withheld_by_reason == {"contact": 1}


@pytest.mark.parametrize(
    ("name", "spoil"),
    [
        ("frames_lost", lambda found: found[0].frames[ROBOT].clear()),
        ("frames_doubled", lambda found: found[1].frames[ROBOT].update([1])),
        ("frames_unexplained", lambda found: found[0].frames.update({b"\x03" * 33: Counter([7])})),
        ("frames_misplaced", lambda found: setattr(found[0], "misplaced_frames", 1)),
        ("frames_unreadable", lambda found: setattr(found[0], "bad_frames", 1)),
        ("records_missing", lambda found: setattr(found[0], "missing_records", 1)),
        ("visits_unclosed", lambda found: setattr(found[0], "unclosed_visits", 1)),
    ],
)
def test_a_run_is_not_good_where_an_owner_finds_it_otherwise(name: str, spoil: Any) -> None:
    found = owners()
    spoil(found)
    spoilt = figures(found)
    assert getattr(spoilt, name) == 1
    assert not is_good(spoilt)


def driven(**differing: Any) -> RobotFigures:
    unlike = {"keep": True, "places": 60, "doubts": 1, "frames": 20, "kept": 30, **differing}
    told = DrivingFigures(**unlike, home_lost=False, unplaced_readings=0, camera_height_m=1.2, camera_pitch_deg=6.0)
    return make_figures(OPTIONS, [(ROBOT, replace(summary(), driving=told), logged())], owners(), {})


def test_a_run_of_a_robot_that_drove_says_what_was_kept_on_the_way_and_is_not_good_if_that_is_nothing() -> None:
    found = driven()
    assert is_good(found)
    assert (found.driving_frames, found.driving_kept, found.driving_kept_share, found.odometry_doubts) == (
        20,
        30,
        0.75,
        1,
    )
    assert not is_good(driven(kept=0))
    assert figures(owners()).driving_kept is UNSET


def test_a_run_is_not_good_where_frames_never_arrived() -> None:
    found = figures(owners(), published=1)
    assert (found.frames_never_arrived, is_good(found)) == (1, False)


def test_a_run_is_not_good_where_a_record_stands_twice_on_the_chain() -> None:
    found = owners()
    found[0].record_count = 2
    assert not is_good(figures(found))


def test_a_run_in_which_nothing_was_kept_is_not_good() -> None:
    assert not is_good(replace(figures(owners()), frames_kept=0, frames_found=0))


def test_memory_is_the_kernels_own_peak_where_it_tells(tmp_path: Path) -> None:
    status = tmp_path / "status"
    status.write_text("Name:\tpython\nVmPeak:\t  9000 kB\nVmHWM:\t  512 kB\n")
    assert read_peak_bytes(status) == 512 * 1024
    assert read_peak_bytes(tmp_path / "none") > 1024 * 1024

"""What the commands that listen to a robot refuse before they listen, and what a live run's last lines say."""

from __future__ import annotations

import time
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from msgspec.structs import replace

from clients.robot.backgrounds.background_banks import FRAMES_MIN_COUNT, approve_scene, record_scene
from clients.robot.cli import main
from clients.robot.cli.live_options import BESIDE, CAMERAS, notice_teller
from clients.robot.cli.run_report import broken_line, summary_lines, waiting_line
from clients.robot.identity.robot_keys import create_identity
from clients.robot.matching.match_evidence import MatchEvidence, Obstacle
from clients.robot.recording.frame_answers import FrameCounts
from clients.robot.recording.run_statistics import RunStatistics
from clients.robot.run.run_summary import RunProgress
from clients.robot.sensing.camera_intrinsics import CameraFigures
from tests.unit.clients.robot.run_summaries import summary_of

NOBODY = "http://127.0.0.1:9"


def robot(tmp_path: Path, *arguments: str) -> Result:
    if not (tmp_path / "robot").exists():
        create_identity(tmp_path / "robot")
    return CliRunner().invoke(main.robot, ["--robot-dir", str(tmp_path), *arguments])


def test_a_live_run_without_an_approved_empty_scene_is_refused_with_how_to_record_one(tmp_path: Path) -> None:
    done = robot(tmp_path, "run", "--source", "ros1")
    assert done.exit_code == 2
    assert "background record --source ros1 --viewpoint NAME" in done.output


@pytest.mark.parametrize(
    "arguments",
    [
        ("run", "--source", "ros1", "--viewpoint", "ward"),
        ("run", "--source", "ros1", "--viewpoint", "ward", "--tags", "/rfid"),
        ("topics", "--source", "ros1"),
        ("background", "record", "--source", "ros1", "--viewpoint", "ward"),
    ],
)
def test_a_middleware_that_does_not_answer_is_named_with_its_address(
    tmp_path: Path, arguments: tuple[str, ...]
) -> None:
    done = robot(tmp_path, *arguments, "--ros-master", NOBODY)
    assert done.exit_code == 1
    assert "FEED_UNREACHABLE" in done.output
    assert NOBODY in done.output


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("topics",), "Name a RECORDING, or with --source"),
        (("topics", "some.bag", "--source", "ros1"), "not both"),
        (("background", "record", "--viewpoint", "w"), "Name a RECORDING, or with --source"),
        (("background", "record", "some.bag", "--source", "ros1", "--viewpoint", "w"), "not both"),
        (
            ("background", "record", "--source", "ros1", "--empty-seconds", "0..1", "--viewpoint", "w"),
            "--empty options",
        ),
        (("run", "--source", "ros3"), "is not one of"),
        (("topics", "--source", "ros1", "--ros-master", "hello"), "hello is no address of a ROS 1 master"),
        (("topics", "--source", "ros1", "--llrp", "127.0.0.1"), "No such option"),
        (("background", "record", "--source", "ros1", "--viewpoint", "w", "--llrp", "127.0.0.1"), "No such option"),
    ],
)
def test_what_cannot_be_meant_is_wrong_usage(tmp_path: Path, arguments: tuple[str, ...], said: str) -> None:
    done = robot(tmp_path, *arguments)
    assert done.exit_code == 2
    assert said in done.output


def test_every_feed_is_offered_and_adds_options_of_its_own(tmp_path: Path) -> None:
    offered = robot(tmp_path, "run", "--help").output
    assert all(name in offered for name in ["synthetic", *CAMERAS])
    names = [
        option(lambda: None).__click_params__[0].name
        for kind in [*CAMERAS.values(), *BESIDE.values()]
        for option in kind.options
    ]
    assert len(names) == len(set(names)), "two feeds claim one option"


def test_where_distances_are_off_a_guessed_focal_length_is_among_the_suspects() -> None:
    statistics = RunStatistics(window_ms=5_000)
    statistics.add_off("tag-1", MatchEvidence(1.0, None, 9, 0.63, 0.2, 9, 0, 1, 2.0, 0.1, 2.5))
    statistics.add_ambiguous("tag-1", statistics.distances_off["tag-1"][1])
    (row,), off = statistics.summarise_ambiguous(), statistics.summarise_distances_off()
    assert row.obstacle == Obstacle.OFF
    for guess, count in (("assumed", 2), ("topics", 0)):
        camera = CameraFigures(focal_px=525.0, focal_from=guess, frames_before=0)
        told = replace(summary_of(COUNTS), ambiguous=[row], distances_off=off, camera=camera)
        said = "\n".join(summary_lines(told))
        assert said.count("; and focal_px: 525 pixels are a guess.") == count
        vague = replace(told, ambiguous=[replace(row, obstacle="vague")], distances_off=[])
        assert "focal_px" not in "\n".join(summary_lines(vague))


COUNTS = FrameCounts(published=5, covered=5, kept=5, withheld=0, withheld_reasons={}, lost=0)


def test_a_live_runs_last_lines_say_what_was_not_read_and_what_was_gone() -> None:
    intake = {
        "missed": {"frame": 3},
        "unread": {"sighting": 2},
        "never_came": {"/depth": 4},
        "gone": {"/depth": 1, "/rfid": 2},
    }
    assert list(summary_lines(summary_of(COUNTS, **intake)))[1:] == [
        "Not read: 3 depth images came while there was no room for them; this machine is too slow.",
        "Never came: 4 messages of /depth, lost between the robot's middleware and here.",
        "Not read: 2 tag readings had just come when the run ended.",
        "Gone 1 time for a while: /depth.",
        "Gone 2 times for a while: /rfid.",
    ]


def test_frames_that_are_withheld_are_said_with_their_reasons_and_where_these_are_explained() -> None:
    all_of_them = replace(COUNTS, kept=0, withheld=5, withheld_reasons={"no-distance": 5})
    first, pointer = summary_lines(summary_of(all_of_them))
    assert first == (
        "5 frames; counted for each owner: 0 kept, 5 withheld (no-distance), 0 lost. 1 record says what was withheld."
    )
    assert "docs/how-to/your-robot.md" in pointer
    some = replace(COUNTS, kept=2, withheld=3, withheld_reasons={"crowd": 1, "no-distance": 2})
    assert list(summary_lines(summary_of(some))) == [
        "5 frames; counted for each owner: 2 kept in 1 record, 3 withheld (1 crowd, 2 no-distance), 0 lost."
    ]


def test_a_run_of_which_nothing_was_in_reach_of_a_reading_says_that_nothing_was_kept_and_why() -> None:
    nothing = replace(COUNTS, covered=0, kept=0)
    intake = {
        "messages_refused": {"sighting": {"field": 51}},
        "first_refused": {"sighting": "There is no field antena."},
    }
    _, reach, kept, refused = summary_lines(summary_of(nothing, **intake))
    assert "No frame was in reach of a reading" in reach
    _, silent, *_ = summary_lines(summary_of(nothing, **intake), ["/rfid"])
    assert silent == "No reading of a tag came: 0 messages of /rfid."
    assert kept.startswith("No frame was kept.")
    assert refused == (
        "Not usable: 51 tag readings (51 field: a field that the topics file names is not there, or holds something else). "
        "The first: There is no field antena."
    )


def test_the_last_lines_tell_of_antennas_distances_and_json_that_nobody_expected() -> None:
    line = list(summary_lines(summary_of(COUNTS, antennas_unnamed={"/rfid": {"0": 26}})))[1]
    assert line.startswith("Antennas heard on /rfid that its front and back do not name: 0 (26 times).")
    statistics = RunStatistics(window_ms=5_000)
    for _ in range(2):
        statistics.add_off("tag-1", MatchEvidence(12.0, None, 30, 1.5, 1.0, 30, 0, 1, 2.0, 0.4, 2.5))
    line = list(summary_lines(replace(summary_of(COUNTS), distances_off=statistics.summarise_distances_off())))[1]
    assert line.startswith("tag-1, 2 kept: its distances are on average +1.50 m off the camera's (stated error 1.00 m;")
    lines = list(summary_lines(summary_of(COUNTS, messages_refused={"sighting": {"json": 90}})))
    assert lines[-1] == 'A field holds JSON text: name the value in it in the topics file, as in epc = "data{}.uid".'


def test_tags_that_were_never_bound_are_said_with_the_matchers_numbers() -> None:
    statistics = RunStatistics(window_ms=5_000)
    early, late = (MatchEvidence(4.4, None, count, 0.021, 0.15, 0, 0, 1) for count in (4, 18))
    worse = MatchEvidence(-50.0, None, 120, 0.021, 0.15, 0, 0, 1)
    for evidence in (early, late, worse):
        statistics.add_ambiguous("tag-1", evidence)
    summary = replace(summary_of(COUNTS), ambiguous=statistics.summarise_ambiguous())
    line = list(summary_lines(summary))[1]
    assert line.startswith(
        "tag-1, 3 ambiguous: log-odds 4.4 of 9.2 needed; 18 distances, on average +0.02 m off the camera's (stated error "
        "0.15 m; they differ from that by 0.00 m, one by one); "
        "0 readings in front, 0 behind: no reading said which way its antenna looks"
    )


@pytest.mark.parametrize(("is_terminal", "before"), [(True, "\r\x1b[K"), (False, "")])
def test_at_a_terminal_a_notice_takes_the_place_of_the_line_of_progress(
    monkeypatch: pytest.MonkeyPatch, is_terminal: bool, before: str
) -> None:
    class Screen(StringIO):
        def isatty(self) -> bool:
            return is_terminal

    screen = Screen()
    monkeypatch.setattr("sys.stderr", screen)
    notice_teller(as_json=False)("/depth is there.")
    assert screen.getvalue() == f"{before}/depth is there.\n"
    assert broken_line(RunProgress(), 0, "spool", is_live=True).startswith("Ended at once.")


def test_clips_from_a_run_before_and_uploads_that_were_not_taken_are_told() -> None:
    assert waiting_line(1).startswith("1 sealed clip waits from a run before")
    assert waiting_line(8).startswith("8 sealed clips wait from a run before")
    summary = replace(summary_of(COUNTS), uploads_refused={"DISK_RESERVE_REACHED": 1, "UPLOAD_QUOTA_EXCEEDED": 7})
    line = list(summary_lines(summary))[1]
    assert "took no upload 8 times (1 DISK_RESERVE_REACHED, 7 UPLOAD_QUOTA_EXCEEDED)" in line
    assert len(list(summary_lines(summary_of(COUNTS)))) == 1


def test_approved_empty_frames_are_called_approved_once(tmp_path: Path) -> None:
    create_identity(tmp_path / "robot")
    now_ms = time.time_ns() // 1_000_000
    frames = [np.full((48, 64), 3_000, np.uint16)] * FRAMES_MIN_COUNT
    record_scene(tmp_path / "robot", "ward-3", frames, now_ms)
    assert robot(tmp_path, "background", "list").output.strip() == f"ward-3: {FRAMES_MIN_COUNT} frames, recorded"
    approve_scene(tmp_path / "robot", "ward-3", by="A. Nurse", days=1, now_ms=now_ms)
    said = " ".join(robot(tmp_path, "background", "list").output.split())
    assert f"ward-3: {FRAMES_MIN_COUNT} frames, approved by A. Nurse until 2" in said

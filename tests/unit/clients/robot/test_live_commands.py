"""What the commands that listen to a robot refuse before they listen, and what a live run's last lines say."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from clients.robot import cli
from clients.robot.identity import create_identity
from clients.robot.run_words import summary_lines
from clients.robot.sources.feeds import BESIDE, CAMERAS

NOBODY = "http://127.0.0.1:9"


def robot(tmp_path: Path, *arguments: str) -> Result:
    if not (tmp_path / "robot").exists():
        create_identity(tmp_path / "robot")
    return CliRunner().invoke(cli.robot, ["--robot-dir", str(tmp_path), *arguments])


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


def test_a_live_runs_last_lines_say_what_was_not_read_and_what_was_gone() -> None:
    counts = {"published": 5, "kept": 5, "withheld": 0, "lost": 0}
    intake = {
        "unknown_tags": {"readings": 0},
        "messages_refused": {},
        "missed": {"frame": 3},
        "unread": {"sighting": 2},
        "never_came": {"/depth": 4},
        "gone": {"/depth": 1, "/rfid": 2},
    }
    consents = {"stale_times": 0, "sightings_refused": {}, "clips_dropped": 0}
    summary = {"frames": counts, "senses": {}, "records": 1, "intake": intake, "consents": consents}
    assert list(summary_lines(summary))[1:] == [
        "Not read: 3 messages of kind frame came while there was no room for them; this machine is too slow.",
        "Never came: 4 messages of /depth, lost between the robot's middleware and here.",
        "Not read: 2 messages of kind sighting had just come when the run ended.",
        "Gone 1 time for a while: /depth.",
        "Gone 2 times for a while: /rfid.",
    ]

"""Each tag's frames in the log are held against the scenario, not sums over all tags, nor the robot's own counts."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest

from clients.robot.recording.frame_answers import FrameCounts
from clients.robot.synthetic.scenario_bag import scenario_of
from network.demo.checks import CheckList
from network.demo.scene_truth import covered_frames
from network.experiments.comparison import work_out
from network.experiments.definitions import EXPERIMENTS
from network.experiments.guard import Guard
from network.experiments.pages.event_table import EventTable, LoggedEvent
from network.experiments.run_one import ExperimentRun, are_covered_frames, frames_by_tag

EXPERIMENT = EXPERIMENTS[2]
SCENARIO = scenario_of(EXPERIMENT.load_scene())
OWN = {alias: covered_frames(SCENARIO, alias) for alias in EXPERIMENT.people}
FIRST, SECOND = EXPERIMENT.people


def log(paired: dict[str, set[int]], *, withheld: frozenset[int] = frozenset(), cut: int = 0) -> EventTable:
    """A run's log; of the frames before `cut` nothing is told after pairing."""
    events = [LoggedEvent(number, "IMAGE_RETRIEVE", f"frame-{number}") for number in range(SCENARIO.frame_count)]
    for alias, numbers in paired.items():
        for number in numbers:
            ends = ["IMAGE_WITHHELD"] if number in withheld else ["DATABASE_PERSISTANCE", "BLOCKCHAIN_TRANSACTION"]
            for later, activity in enumerate(["IMAGE_PAIRED", *(ends if number >= cut else [])]):
                events.append(LoggedEvent(10_000 + number + later, activity, f"frame-{number}", alias))
    return EventTable.of("by hand", events)


def failed(tmp_path: Path, table: EventTable, **said: int) -> list[str]:
    """The checks that fail for a log, where the robot says that all is well."""
    checks = CheckList(listener=lambda check: None)
    run = ExperimentRun(
        EXPERIMENT,
        SCENARIO,
        tmp_path,
        cache=tmp_path,
        base_port=1,
        checks=checks,
        on_progress=lambda _: None,
        guard=Guard(),
    )
    tags = frames_by_tag(table).values()
    withheld = sum(len(tag.withheld) for tag in tags)
    frames = {
        "published": SCENARIO.frame_count,
        "covered": sum(len(own) for own in OWN.values()),
        "kept": sum(len(own) for own in OWN.values()) - withheld,
        "withheld": withheld,
        "withheld_reasons": {"ambiguous": withheld} if withheld else {},
        "lost": 0,
        **said,
    }
    run._check_frames(work_out("ours", table), msgspec.convert(frames, FrameCounts))
    return [check.name for check in checks.checks if not check.ok]


def test_a_log_with_each_persons_own_frames_passes(tmp_path: Path) -> None:
    assert failed(tmp_path, log({"tag-1": OWN[SECOND], "tag-2": OWN[FIRST]})) == []
    assert failed(tmp_path, log({"tag-1": OWN[SECOND], "tag-2": OWN[FIRST]}, withheld=frozenset(range(300)))) == []


def test_a_frame_too_few_of_one_and_too_many_of_the_other_is_seen_though_the_sum_is_right(tmp_path: Path) -> None:
    mine, not_mine = min(OWN[FIRST] - OWN[SECOND]), max(set(range(SCENARIO.frame_count)) - OWN[SECOND] - {0})
    wrong = {"tag-1": OWN[FIRST] - {mine}, "tag-2": OWN[SECOND] | {not_mine}}
    assert sum(map(len, wrong.values())) == sum(map(len, OWN.values()))
    assert failed(tmp_path, log(wrong)) == [
        "the frames around each registered tag's readings were paired, and no others"
    ]


@pytest.mark.parametrize("given", [{"tag-1": OWN[FIRST]}, {"tag-1": OWN[FIRST], "tag-2": OWN[FIRST]}])
def test_frames_at_one_tag_or_twice_are_not_everybodys_own(given: dict[str, set[int]]) -> None:
    assert not are_covered_frames(frames_by_tag(log(given)).values(), OWN)


def test_a_robot_that_says_all_was_kept_is_not_believed(tmp_path: Path) -> None:
    told = failed(tmp_path, log({"tag-1": OWN[FIRST], "tag-2": OWN[SECOND]}, cut=min(OWN[FIRST]) + 3))
    assert "no frame that should be kept is lost" in told
    assert "what the robot says of its frames is what its log shows" in told
    missing = {"tag-1": OWN[FIRST], "tag-2": OWN[SECOND]}
    assert failed(tmp_path, log(missing), lost=1) == ["what the robot says of its frames is what its log shows"]

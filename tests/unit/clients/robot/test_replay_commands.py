"""What `blockrobot robot replay` says of a recording that breaks off, and of options that make no sense."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest
from click.testing import CliRunner, Result
from msgspec.structs import replace

from clients.robot.cli import main
from clients.robot.identity.robot_keys import create_identity
from clients.robot.pairing.rosters import UnknownTagCounts
from clients.robot.recording.frame_answers import SenseCounts
from clients.robot.run.run_summary import RunSummary
from clients.robot.sensing.input_checks import RunFault
from clients.robot.sources.recordings.bag_source import BagSource
from clients.sdk.terminal.json_answers import extend
from tests.unit.clients.robot.run_summaries import FRAMES, summary_of

BROKEN = RunFault(code="BAG_DAMAGED", detail="The recording breaks off.")


@pytest.fixture
def replay(monkeypatch: pytest.MonkeyPatch, small_bag: Path, tmp_path: Path) -> Any:
    """Run the command over the small bag, the run itself replaced by its summary."""
    sources: list[BagSource] = []

    def run(
        *options: str,
        fault: RunFault | None = None,
        lost: int = 0,
        unknown: tuple[int, int] = (0, 0),
        **live: dict[str, int],
    ) -> Result:
        async def summarised(_folder: Path, source: BagSource, *_rest: object) -> RunSummary:
            sources.append(source)
            tags = UnknownTagCounts(readings=unknown[0], tags=unknown[1], more_tags=False)
            refused = {"frame": {"size": 2, "step": 1}}
            summary = summary_of(FRAMES, messages_refused=refused, unknown_tags=tags, fault=fault, **live)
            senses = {"rgb": extend(SenseCounts, replace(FRAMES, lost=lost), dropped=0)}
            return replace(summary, senses=senses, records=3)

        monkeypatch.setattr(main, "replay_recording", summarised)
        monkeypatch.setattr(main, "load_genesis", lambda _path: None)
        if not (tmp_path / "robot").exists():
            create_identity(tmp_path / "robot")
        arguments = ["--robot-dir", str(tmp_path), "replay", str(small_bag), *options]
        return CliRunner().invoke(main.robot, arguments)

    return run


def test_what_could_not_be_used_is_told_by_reason_and_tags_off_the_roster_by_number(replay: Any) -> None:
    done = replay()
    assert done.exit_code == 0
    assert "Not usable: 3 depth images (2 size: of a wrong size; 1 step: width" in done.output
    assert "6 of rgb: 6 kept" in done.output
    assert "not on the roster" not in replay().output
    told = replay(unknown=(37, 2)).output
    assert "Readings of 2 tags that are not on the roster: 37; nothing is kept for them." in told
    assert "Readings of a tag that is not on the roster: 9;" in replay(unknown=(9, 1)).output
    assert json.loads(replay("--json", unknown=(37, 2)).stdout)["intake"]["unknown_tags"]["tags"] == 2


def test_a_recording_that_breaks_off_is_told_after_what_was_kept(replay: Any) -> None:
    done = replay(fault=BROKEN)
    assert done.exit_code != 0
    assert "6 kept in 3 records" in done.output
    assert "BAG_DAMAGED" in done.output
    assert "What came before it is recorded." in done.output


def test_in_json_it_is_one_object_with_the_figures_and_the_error(replay: Any) -> None:
    done = replay("--json", fault=BROKEN)
    assert done.exit_code != 0
    told = json.loads(done.stdout)
    assert (told["ok"], told["frames"], told["error"]["code"]) == (False, msgspec.to_builtins(FRAMES), "BAG_DAMAGED")
    assert json.loads(replay("--json").stdout)["ok"] is True


@pytest.mark.parametrize(
    ("code", "exit_code"),
    [("ROSTER_EXPIRED", 4), ("BACKGROUND_EXPIRED", 4), ("BACKGROUND_NOT_FOUND", 3), ("FEED_LOST", 1)],
)
@pytest.mark.parametrize("options", [(), ("--json",)])
def test_what_ended_a_run_is_its_exit_code(replay: Any, options: tuple[str, ...], code: str, exit_code: int) -> None:
    done = replay(*options, fault=RunFault(code=code, detail="It is over."))
    assert done.exit_code == exit_code
    assert "What came before it is recorded." in done.output


def test_something_lost_of_another_sense_is_not_well(replay: Any) -> None:
    assert json.loads(replay("--json", lost=1).stdout)["ok"] is False


@pytest.mark.parametrize("what", ["missed", "never_came"])
def test_something_lost_on_the_way_or_for_lack_of_room_is_not_well(replay: Any, what: str) -> None:
    assert json.loads(replay("--json", **{what: {"frame": 1}}).stdout)["ok"] is False
    assert json.loads(replay("--json", **{what: {}}, unread={"frame": 1}, gone={"/rfid": 2}).stdout)["ok"] is True


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["--depth", "/nowhere"], "BAG_TOPIC_MISSING"),
        (["--tags", "/nowhere"], "BAG_TOPIC_MISSING"),
        (["--tags", "/camera/depth/image_raw"], "TOPICS_INVALID"),
        (["--topics", "nowhere.toml"], "TOPICS_INVALID"),
        (["--empty-seconds", "3"], "--empty-seconds"),
        (["--empty-seconds", "5..3"], "--empty-seconds"),
        (["--empty-seconds", "a..b"], "--empty-seconds"),
    ],
)
def test_options_that_make_no_sense_are_named_before_the_run(replay: Any, options: list[str], told: str) -> None:
    done = replay(*options)
    assert done.exit_code != 0
    assert told in done.output

"""What surrounds a run of experiments: its folder, its guard, its scenarios and its page."""

from __future__ import annotations

import fcntl
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from clients.robot.recording.frame_answers import FrameCounts
from clients.robot.synthetic.scenario import Scenario
from consensus.errors import BlockRobotError
from network.demo.checks import Check, CheckList
from network.demo.scene_truth import covered_frames
from network.experiments import guard as guard_module
from network.experiments.comparison import work_out
from network.experiments.definitions import EXPERIMENTS
from network.experiments.guard import run_guard
from network.experiments.out_folder import MARK, make_experiment_folder, reserved_out
from network.experiments.pages.event_table import EventTable, LoggedEvent
from network.experiments.pages.experiment_page import build_index, build_page
from network.experiments.pages.tables import figure_rows
from network.experiments.post_stage import WalletContents
from network.experiments.progress import Progress
from network.experiments.run_figures import work_out_figures
from network.experiments.run_one import Outcome
from tests.unit.clients.robot.run_summaries import summary_of


def refused(out: Path) -> str:
    with pytest.raises(BlockRobotError) as caught, reserved_out(out):
        raise AssertionError("the folder was taken")
    assert caught.value.code == "FOLDER_NOT_EMPTY"
    return caught.value.detail


def earlier(out: Path) -> Path:
    """A folder as an earlier run left it."""
    folder = out / "experiment-1"
    folder.mkdir(parents=True)
    (out / MARK).touch()
    (out / "summary.json").touch()
    (folder / "events.jsonl").touch()
    record = folder / "pictures" / "patient-a" / ("0a" * 32)
    record.mkdir(parents=True)
    (record / "picture-0003.frame-00000012.png").touch()
    (record / "picture-0003.frame-00000012.depth.png").touch()
    (folder / "network" / "nodes" / "node-1" / "ledger").mkdir(parents=True)
    (folder / "network" / "nodes" / "node-1" / "ledger" / "data.mdb").touch()
    (folder / "wallets").mkdir()
    (folder / "wallets" / "patient-a.words").touch()
    return folder


def test_a_new_an_empty_and_an_earlier_folder_are_taken(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    earlier(tmp_path / "again")
    for name in ("new", "empty", "again"):
        with reserved_out(tmp_path / name):
            assert (tmp_path / name / MARK).is_file()


def test_somebody_elses_folder_is_left_as_it_is(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("years of work", encoding="utf-8")
    assert "not of an earlier run" in refused(tmp_path)
    assert [item.name for item in tmp_path.iterdir()] == ["thesis.txt"]


@pytest.mark.parametrize(
    "place",
    [
        "notes.txt",
        "experiment-1/notes.txt",
        "experiment-5",
        "experiment-1/pictures/my-notes.txt",
        "experiment-1/pictures/patient-a/chosen.png",
        "experiment-1/wallets/patient-a.txt",
        "experiment-1/robots/robot/spool/notes",
        "experiment-1/network/organisations/hospital/letter.pdf",
        "experiment-1/network/nodes/node-1/ledger/copy/data.mdb",
    ],
)
def test_a_foreign_file_among_results_is_left_as_it_is(tmp_path: Path, place: str) -> None:
    earlier(tmp_path)
    (tmp_path / place).parent.mkdir(parents=True, exist_ok=True)
    (tmp_path / place).write_text("mine", encoding="utf-8")
    assert place.rsplit("/", maxsplit=1)[-1] in refused(tmp_path)
    assert (tmp_path / place).read_text(encoding="utf-8") == "mine"


def test_links_are_not_followed(tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real")
    assert "link" in refused(tmp_path / "link")
    folder = earlier(tmp_path / "out")
    (folder / "robots").symlink_to(tmp_path / "real")
    assert "robots" in refused(tmp_path / "out")
    (folder / "robots").unlink()
    (folder / "pictures" / "patient-b").symlink_to(tmp_path / "real")
    assert "patient-b" in refused(tmp_path / "out")


def test_an_experiment_begins_with_an_empty_folder_that_no_other_run_shares(tmp_path: Path) -> None:
    earlier(tmp_path)
    with (tmp_path / MARK).open("a") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        assert "at work" in refused(tmp_path)
    (tmp_path / "experiment-2").mkdir()
    (tmp_path / "experiment-2" / "events.jsonl").touch()
    assert list(make_experiment_folder(tmp_path, "experiment-1").iterdir()) == []
    assert (tmp_path / "experiment-2" / "events.jsonl").exists()


def sleeper(*words: str) -> subprocess.Popen[bytes]:
    """Running: right after fork /proc shows no command line yet."""
    code = "import time; print(flush=True); time.sleep(60)"
    process = subprocess.Popen([sys.executable, "-c", code, *words], stdout=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.readline()
    return process


def test_the_guard_ends_what_a_killed_run_started_and_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    stopped: list[Path] = []
    monkeypatch.setattr(guard_module, "stop_network", stopped.append)
    own, other = sleeper("network.cli.main"), sleeper("somebody-else")
    try:
        run_guard([f"pid {own.pid}\n", f"pid {other.pid}\n", "network /a b/network\n"])
        assert own.wait(10) == -9
        assert other.poll() is None
        assert stopped == [Path("/a b/network")]
    finally:
        for process in (own, other):
            process.kill()
            process.communicate()


def test_the_guard_leaves_all_to_a_run_that_ends_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    stopped: list[Path] = []
    monkeypatch.setattr(guard_module, "stop_network", stopped.append)
    run_guard(["network /somewhere\n", "end\n"])
    assert stopped == []


def scenario_of(number: int) -> Scenario:
    scene = EXPERIMENTS[number - 1].load_scene()
    assert isinstance(scene, Scenario)
    return scene


def test_the_experiments_are_those_of_the_published_runs_and_their_figures_have_the_names_of_ours() -> None:
    """1,497 frames at 30 a second, four readings; ±5 s around them cover as many frames as the published log tells."""
    scenario = scenario_of(1)
    (person,) = scenario.people
    assert (scenario.frame_count, scenario.frame_rate, len(person.readings_s)) == (1_497, 30, 4)
    assert len(covered_frames(scenario, "patient-a")) == 486
    assert scenario_of(2) == scenario
    scenario = scenario_of(3)
    first, second = scenario.people
    assert first.path[-1][0] < second.path[0][0]
    both = covered_frames(scenario, "patient-a") & covered_frames(scenario, "patient-b")
    alone = [number for number in both if first.place(number / 27) and not second.place(number / 27)]
    assert len(alone) > 90
    scenario = scenario_of(4)
    assert (scenario.duration_s, scenario.frame_rate) == (60.8, 27)
    assert sum(len(person.readings_s) for person in scenario.people) == 17
    assert len(scenario.tagged_aliases) == 4
    assert set(EXPERIMENTS[3].people) < set(scenario.tagged_aliases)
    covered = [len(covered_frames(scenario, alias)) / 27 for alias in EXPERIMENTS[3].people]
    assert covered == [pytest.approx(53.1, abs=0.1), pytest.approx(31.3, abs=0.1)]
    names = {name for name, _ in figure_rows(work_out_figures(small_table()))}
    for experiment in EXPERIMENTS:
        assert set(experiment.beside.figures) <= names


def small_table() -> EventTable:
    steps = [("IMAGE_RETRIEVE", 0), ("IMAGE_PAIRED", 6_010), ("DATABASE_PERSISTANCE", 6_400)]
    events = [LoggedEvent(at, activity, "frame-1", "tag-x" if at else "") for activity, at in steps]
    return EventTable.of("by hand", [*events, LoggedEvent(7_000, "BLOCKCHAIN_TRANSACTION", "frame-1", "tag-x")])


def outcome(tmp_path: Path, *, ok: bool) -> Outcome:
    checks = CheckList(listener=lambda check: None)
    checks.add("own <data> only", ok=ok, detail="0 of 1 & none")
    picture = tmp_path / "picture-0003.frame-00000012.png"
    picture.write_bytes(b"\x89PNG")
    frames = FrameCounts(published=1, covered=1, kept=1, withheld=0, withheld_reasons={}, lost=0)
    belongings = {"patient-a": WalletContents([], [picture], []), "patient-b": WalletContents()}
    made = Outcome(EXPERIMENTS[0], scenario_of(1), checks, summary_of(frames), belongings=belongings)
    return replace(made, reading=work_out("ours", small_table()))


def test_the_page_is_one_file_that_says_what_was_paired_where_time_went_and_what_was_lost(tmp_path: Path) -> None:
    page = build_page(outcome(tmp_path, ok=True), BlockRobotError("DRAWING_UNAVAILABLE"))
    for heading in ("What share was paired", "Where the time goes", "What was lost", "Beside published run 1", "<svg "):
        assert heading in page
    assert "own &lt;data&gt; only" in page
    assert "0 of 1 &amp; none" in page
    assert "apt install graphviz" in page
    assert page.count("data:image/png;base64,") == 1
    assert not re.findall(r"(?:src|href)=['\"](?!data:|#)", page)
    assert "Every check held." in page


def test_a_failed_check_is_on_both_pages_and_in_the_figures(tmp_path: Path) -> None:
    failed = outcome(tmp_path, ok=False)
    assert not failed.ok
    assert failed.figures().checks_failed == ["own <data> only"]
    assert "FAILED" in build_page(failed, None)
    index = build_index([failed], 5.0, {"nodes": 4})
    assert "FAILED" in index
    assert "experiment-1/report.html" in index
    assert "Not every claim held." in index


def test_the_page_over_all_says_in_words_how_many_checks_held_and_how_it_was_measured(tmp_path: Path) -> None:
    made = outcome(tmp_path, ok=True)
    conditions = {"nodes": 4, "seed": None, "scenarios": {"experiment-1": "ab"}, "drawn_by": "graphviz"}
    index = build_index([made], 1092.5, conditions)
    count = len(made.checks.checks)
    assert f"{count} of {count} checks held." in index
    assert "All of it took 1,092 s. Measured with: nodes 4, drawn by graphviz." in index
    assert "None" not in index
    assert "<nav" not in index, "one part needs no contents"
    assert "<nav" in build_page(made, None)


def test_an_experiment_that_never_recorded_has_a_page_and_did_not_hold(tmp_path: Path) -> None:
    made = replace(outcome(tmp_path, ok=True), reading=None, robot=None)
    assert not made.ok
    assert "What was checked" in build_page(made, None)


def test_progress_is_on_standard_error_and_thinned_out(capsys: pytest.CaptureFixture[str]) -> None:
    progress = Progress(as_json=True)
    for number in range(50):
        progress.tell(f"experiment-1: run: {number} frames seen")
    progress.tell("experiment-1: post-stage: looking")
    progress.show(EXPERIMENTS[0], Check("all is well", ok=True, detail="seen"))
    told = capsys.readouterr()
    assert told.out == ""
    assert [line.split('"')[1] for line in told.err.splitlines()] == ["progress", "progress", "check"]

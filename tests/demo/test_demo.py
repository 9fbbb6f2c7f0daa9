"""The demonstration itself, as a newcomer runs it: real processes, real recording, every check ticked, on either store."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from network.bench.fresh_network import find_base_port
from network.cli.measure.demo_commands import MARK, OWN_FILES
from network.run_folder import reserved_folder
from tests.demo.fewer_frames import with_fewer_frames
from tests.ui.reading_reports import look_all_ways, pictures_in, print_on_a4, watched_page

DEMO_TIMEOUT_S = 480
ENDING_TIMEOUT_S = 60


@dataclass(frozen=True, slots=True)
class DemoRun:
    """A demonstration that has ended: its folder, its exit code and its one object."""

    out: Path
    code: int
    answer: dict[str, Any]


def start_demo(home: Path, out: Path, *arguments: str, module: str = "network.cli.main") -> subprocess.Popen[bytes]:
    """Start `blockrobot demo --json`."""
    ports = str(find_base_port(4))
    command = [sys.executable, "-m", module, "demo", "--json", "--out", str(out), "--base-port", ports]
    return subprocess.Popen(
        [*command, *arguments],
        env={**os.environ, "BLOCKROBOT_HOME": str(home)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,  # Ctrl-C is for the test, which tells it once: a second signal would break off its ending
    )


def read_demo(demo: subprocess.Popen[bytes]) -> tuple[int, dict[str, Any]]:
    """Wait for a demonstration to end; return its exit code and its one object. One that is broken off leaves no node."""
    with demo:
        try:
            output, errors = demo.communicate(timeout=DEMO_TIMEOUT_S)
        except (subprocess.TimeoutExpired, KeyboardInterrupt):
            demo.terminate()
            demo.communicate(timeout=ENDING_TIMEOUT_S)
            raise
        finally:
            demo.kill()
    assert b"Traceback" not in errors
    answer: dict[str, Any] = json.loads(output)
    return demo.returncode, answer


def run_demo(home: Path, out: Path, *arguments: str) -> tuple[int, dict[str, Any]]:
    """Run `blockrobot demo --json` and return its exit code and its one object."""
    return read_demo(start_demo(home, out, *arguments))


def require_whole_story(run: DemoRun, frames_count: int) -> None:
    """Every check held, no frame is lost, and what the demonstration leaves is as it says."""
    out, code, answer = run.out, run.code, run.answer
    assert failed_checks(answer) == []
    assert (code, answer["ok"], answer["nodes"], answer["store"]) == (0, True, 4, "sqlite")
    frames = answer["frames"]
    assert frames["published"] == frames_count
    assert frames["lost"] == 0
    assert frames["covered"] == frames["kept"] + frames["withheld"]
    assert frames["withheld"] <= 0.3 * frames["covered"]
    report = (out / "report.html").read_text(encoding="utf-8")
    assert "data:image/png;base64," in report
    assert json.loads((out / "summary.json").read_text(encoding="utf-8")) == answer
    with reserved_folder(out, MARK, OWN_FILES):  # it knows all that it wrote as its own
        pass
    activities = {json.loads(line)["activity"] for line in (out / "events.jsonl").read_text().splitlines()}
    assert {"IMAGE_RETRIEVE", "RFID_RETRIEVE", "IMAGE_PAIRED", "BLOCKCHAIN_TRANSACTION"} <= activities


def failed_checks(answer: dict[str, Any]) -> list[str]:
    return [f"{check['name']}: {check['detail']}" for check in answer["checks"] if not check["ok"]]


@pytest.mark.smoke
def test_an_interrupted_test_lets_its_demonstration_end_its_nodes(monkeypatch: pytest.MonkeyPatch) -> None:
    ends = (
        "import signal, sys; signal.signal(signal.SIGTERM, lambda *_: sys.exit(7)); print('there', flush=True); input()"
    )
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", ends], **pipes) as demo:  # type: ignore[call-overload]
        assert demo.stdout.readline() == b"there\n"
        reading = iter([KeyboardInterrupt])

        def communicate(timeout: float) -> tuple[bytes, bytes]:
            for interrupt in reading:
                raise interrupt
            return subprocess.Popen.communicate(demo, timeout=timeout)

        monkeypatch.setattr(demo, "communicate", communicate)
        with pytest.raises(KeyboardInterrupt):
            read_demo(demo)
    assert demo.returncode == 7


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One home for both runs, so that the recording is rendered once."""
    return tmp_path_factory.mktemp("home")


@pytest.fixture(scope="module")
def embedded(home: Path, tmp_path_factory: pytest.TempPathFactory) -> DemoRun:
    """The demonstration with its embedded store, run once for all who look at what it leaves."""
    out = tmp_path_factory.mktemp("embedded") / "demo"
    return DemoRun(out, *run_demo(home, out))


@pytest.mark.smoke
@pytest.mark.timeout(DEMO_TIMEOUT_S + ENDING_TIMEOUT_S + 20)
def test_the_whole_story_holds_with_fewer_frames(home: Path, tmp_path: Path) -> None:
    out = tmp_path / "demo"
    code, answer = read_demo(start_demo(home, out, module="tests.demo.fewer_frames"))
    require_whole_story(DemoRun(out, code, answer), with_fewer_frames().frame_count)


@pytest.mark.timeout(DEMO_TIMEOUT_S + ENDING_TIMEOUT_S + 20)
def test_the_whole_story_holds_on_embedded_parts(embedded: DemoRun) -> None:
    require_whole_story(embedded, 1500)


@pytest.mark.system_packages
@pytest.mark.timeout(DEMO_TIMEOUT_S + ENDING_TIMEOUT_S + 120)
async def test_the_report_of_the_whole_story_is_readable_by_everybody_and_printed_with_all_pictures(
    embedded: DemoRun,
) -> None:
    report = embedded.out / "report.html"
    async with watched_page() as page:
        await look_all_ways(page, report, "report-of-the-demo")
        assert await page.locator("main").get_by_text("Every check held.").is_visible()
        held = page.get_by_role("row").filter(has=page.locator(".badge.good"))
        assert await held.count() == len(embedded.answer["checks"])
        for person in ("patient A", "patient B"):
            seen = page.get_by_role("img", name=re.compile(rf"^{person}, frame \d+: their silhouette alone"))
            assert await seen.first.is_visible()
        assert pictures_in(report), "people have pictures"
        assert await print_on_a4(page, report, "report-of-the-demo") >= 2


@pytest.mark.timeout(DEMO_TIMEOUT_S + ENDING_TIMEOUT_S + 20)
def test_the_whole_story_holds_with_a_database_per_custodian(home: Path, tmp_path: Path, mongo_uri: str) -> None:
    code, answer = run_demo(home, tmp_path / "demo", "--store", mongo_uri)
    assert failed_checks(answer) == []
    assert (code, answer["store"]) == (0, "mongodb")

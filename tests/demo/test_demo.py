"""The demonstration itself, as a newcomer runs it: real processes, real recording, every check ticked, on either store."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from network.bench.fresh_network import find_base_port

DEMO_TIMEOUT_S = 280


def start_demo(home: Path, out: Path, *arguments: str) -> subprocess.Popen[bytes]:
    """Start `blockrobot demo --json`."""
    ports = str(find_base_port(4))
    command = [sys.executable, "-m", "network.cli.main", "demo", "--json", "--out", str(out), "--base-port", ports]
    return subprocess.Popen(
        [*command, *arguments],
        env={**os.environ, "BLOCKROBOT_HOME": str(home)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


def read_demo(demo: subprocess.Popen[bytes]) -> tuple[int, dict[str, Any]]:
    """Wait for a demonstration to end; return its exit code and its one object."""
    try:
        output, errors = demo.communicate(timeout=DEMO_TIMEOUT_S)
    finally:
        demo.kill()
    assert b"Traceback" not in errors
    answer: dict[str, Any] = json.loads(output)
    return demo.returncode, answer


def run_demo(home: Path, out: Path, *arguments: str) -> tuple[int, dict[str, Any]]:
    """Run `blockrobot demo --json` and return its exit code and its one object."""
    return read_demo(start_demo(home, out, *arguments))


def failed_checks(answer: dict[str, Any]) -> list[str]:
    return [f"{check['name']}: {check['detail']}" for check in answer["checks"] if not check["ok"]]


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One home for both runs, so that the recording is rendered once."""
    return tmp_path_factory.mktemp("home")


@pytest.mark.timeout(DEMO_TIMEOUT_S + 20)
def test_the_whole_story_holds_on_embedded_parts(home: Path, tmp_path: Path) -> None:
    out = tmp_path / "demo"
    code, answer = run_demo(home, out)
    assert failed_checks(answer) == []
    assert (code, answer["ok"], answer["nodes"], answer["store"]) == (0, True, 4, "sqlite")
    frames = answer["frames"]
    assert frames["published"] == 1500
    assert frames["lost"] == 0
    assert frames["covered"] == frames["kept"] + frames["withheld"]
    assert frames["withheld"] <= 0.3 * frames["covered"]
    report = (out / "report.html").read_text(encoding="utf-8")
    assert "data:image/png;base64," in report
    assert json.loads((out / "summary.json").read_text(encoding="utf-8")) == answer
    activities = {json.loads(line)["activity"] for line in (out / "events.jsonl").read_text().splitlines()}
    assert {"IMAGE_RETRIEVE", "RFID_RETRIEVE", "IMAGE_PAIRED", "BLOCKCHAIN_TRANSACTION"} <= activities


@pytest.mark.timeout(DEMO_TIMEOUT_S + 20)
def test_the_whole_story_holds_with_a_database_per_custodian(home: Path, tmp_path: Path, mongo_uri: str) -> None:
    code, answer = run_demo(home, tmp_path / "demo", "--store", mongo_uri)
    assert failed_checks(answer) == []
    assert (code, answer["store"]) == (0, "mongodb")

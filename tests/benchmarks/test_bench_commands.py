"""The benchmarks run against real nodes and answer in the one form of results. Short runs: figures are not judged here."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]


def run(*arguments: str, codes: tuple[int, ...] = (0,)) -> dict[str, Any]:
    command = [sys.executable, "-m", "network.cli.main", "bench", *arguments, "--json"]
    child = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert child.returncode in codes, child.stdout + child.stderr
    result: dict[str, Any] = json.loads(child.stdout)
    return result


def check_form(result: dict[str, Any], name: str) -> dict[str, Any]:
    """Assert the one form of every result and return its figures."""
    assert (result["name"], result["ok"]) == (name, True)
    assert {"nodes", "cores", "load", "python", "seed"} <= set(result["conditions"])
    return dict(result["figures"])


def test_calls_a_second_with_several_robots() -> None:
    figures = check_form(run("tx", "--clients", "3", "--seconds", "1", "--batch", "8"), "tx")
    assert figures["errors"] == 0
    assert figures["count"] >= 24
    assert figures["tps"] > 10
    assert 0 < figures["p50_ms"] <= figures["p95_ms"] <= figures["p99_ms"]


def test_latency_of_one_call_on_an_idle_network() -> None:
    figures = check_form(run("latency", "--count", "5"), "latency")
    assert (figures["count"], figures["errors"]) == (5, 0)
    assert 0 < figures["p50_ms"] <= figures["p95_ms"]


def test_distance_between_hosts_is_measured_and_makes_calls_later() -> None:
    """Whether a goal is met (exit code 0) is not judged here."""
    result = run("wan", "--delay", "0,60", "--loss", "0", "--count", "3", codes=(0, 1))
    near, far = result["figures"]["distances"]
    assert [each["errors"] for each in (near, far)] == [0, 0]
    assert far["p50_ms"] - near["p50_ms"] > 3 * 60
    assert far["is_within_goal"] == (far["p50_ms"] <= far["goal_ms"] == 4.5 * 60 + 15)
    for each in (near, far):
        assert each["calls"] == 3
        assert each["bytes_per_call"] > 1_000
        assert 0 < each["leader_gap_s"] <= 8


@pytest.mark.system_packages
@pytest.mark.parametrize("apart", ["address", "session"])
def test_members_behind_one_proxy_are_not_refused_because_of_each_other(apart: str) -> None:
    figures = check_form(run("proxy", "--members", "4", "--count", "40", "--seconds", "2", "--apart", apart), "proxy")
    assert (figures["submitted"], figures["accepted"], figures["final"]) == (40, 40, 40)
    assert (figures["refused_others"], figures["refused_own"], figures["failed"]) == (0, 0, 0)
    assert 0 < figures["p50_ms"] <= figures["p95_ms"]


def test_the_contract_machine_alone() -> None:
    figures = check_form(run("vm", "--seconds", "0.2", "--profile"), "vm")
    assert all(value > 0 for value in figures.values())


@pytest.mark.smoke
@pytest.mark.parametrize(
    "arguments",
    [
        ("tx", "--clients", "0"),
        ("tx", "--batch", "257"),
        ("latency", "--count", "x"),
        ("wan", "--delay", "20,x"),
        ("wan", "--loss", "21"),
    ],
)
def test_a_wrong_option_is_a_matter_of_usage(arguments: tuple[str, ...]) -> None:
    command = [sys.executable, "-m", "network.cli.main", "bench", *arguments]
    child = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert child.returncode == 2
    assert "Error" in child.stderr


def test_killing_and_cutting_loses_no_acknowledged_call() -> None:
    figures = check_form(run("faults", "--repeats", "1"), "faults")
    assert figures["acknowledged_count"] > 100
    assert (figures["lost_count"], figures["errors"]) == (0, 0)
    assert all(figures[name] > 0 for name in ("leader_kill_gap_s", "heal_gap_s", "restart_ready_s"))


def test_a_robot_keeps_every_frame_over_a_cut_and_its_owners_find_each_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BLOCKROBOT_HOME", str(tmp_path))
    result = run("robot", "--seconds", "6", "--fps", "10", "--robots", "2", "--cut", "2")
    figures = check_form(result, "robot")
    assert result["conditions"]["cut_by"] == "SIGSTOP of all nodes"
    assert figures["frames_published"] == 2 * 60
    assert figures["frames_covered"] == figures["frames_kept"] + figures["frames_withheld"] == 2 * 2 * 60
    assert figures["frames_found"] == figures["frames_kept"] > 0
    assert figures["records_found"] == figures["records"] > 0
    wrong = ("lost", "never_arrived", "doubled", "unexplained", "unreadable")
    assert [figures[f"frames_{name}"] for name in wrong] == [0] * 5
    assert 0 < figures["frame_to_final_p50_ms"] <= figures["frame_to_final_p95_ms"] <= figures["frame_to_final_max_ms"]
    assert all(figures[name] > 0 for name in ("rss_peak_mb", "spool_peak_bytes", "robot_cpu_share", "frames_per_s"))
    assert list((tmp_path / "recordings").glob("bench-robot-10fps-6s-seed1-*/metadata.yaml"))


def test_a_robot_that_drives_keeps_people_on_the_way_and_its_owners_find_each_picture_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BLOCKROBOT_HOME", str(tmp_path))
    result = run("robot", "--drives", "--seconds", "30", "--fps", "6")
    figures = check_form(result, "robot")
    assert result["conditions"]["drives"]
    assert figures["frames_published"] == 180
    assert figures["frames_found"] == figures["frames_kept"] > 0
    assert (figures["frames_lost"], figures["frames_doubled"], figures["odometry_doubts"]) == (0, 0, 0)
    assert 0 < figures["driving_kept"] <= 2 * figures["driving_frames"] < 360
    assert 0 < figures["hiding_p50_ms"] <= figures["hiding_p95_ms"]


@pytest.mark.smoke
def test_less_than_a_round_of_a_robot_that_drives_is_a_matter_of_usage() -> None:
    command = [sys.executable, "-m", "network.cli.main", "bench", "robot", "--drives", "--seconds", "19"]
    child = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert child.returncode == 2
    assert "--drives" in child.stderr


@pytest.mark.smoke
def test_a_cut_as_long_as_the_measurement_is_a_matter_of_usage() -> None:
    command = [sys.executable, "-m", "network.cli.main", "bench", "robot", "--seconds", "5", "--cut", "5"]
    child = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert child.returncode == 2
    assert "--cut" in child.stderr


def test_what_custody_costs() -> None:
    figures = check_form(run("custody", "--behind", "50", "--erasures", "2"), "custody")
    assert (figures["errors"], figures["clips_lost"]) == (0, 0)
    assert 0 < figures["erase_p50_ms"] <= figures["erase_p95_ms"]
    assert all(figures[name] > 0 for name in ("hook_records_per_s", "catchup_s", "scan_records_per_s"))
    assert figures["hospital_day_scan_s"] == pytest.approx(20_000 / figures["scan_records_per_s"], rel=0.01)
    assert 1 < figures["store_overhead"] < 2


def test_what_erasing_costs_beside_kept_clips() -> None:
    figures = check_form(run("custody", "--held", "10,200", "--erasures", "2"), "custody")
    assert ([row["held"] for row in figures["held"]], figures["errors"]) == ([10, 200], 0)
    for row in figures["held"]:
        assert 0 < row["erase_block_p50_ms"] < row["erase_p50_ms"] <= row["erase_p95_ms"]
    assert min(figures["erase_ratio"], figures["cpu_ratio"]) >= 1

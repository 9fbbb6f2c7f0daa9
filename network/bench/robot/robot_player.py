"""One robot process of `bench robot`: the real client on a looped recording."""

from __future__ import annotations

import argparse
import asyncio
import os
import resource
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import msgspec
from msgspec import Struct

from clients.robot.recording.batching import CLIP_DEFAULT_MS
from clients.robot.run.run_summary import RunProgress, RunSummary
from clients.robot.run.runner import ReplayOptions, replay_recording
from clients.robot.sources.messages.topics import load_topics
from clients.sdk.terminal.json_answers import extend
from clients.sdk.terminal.terminal import load_genesis
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from consensus.visible_text import split_lines
from network.bench.robot.robot_scene import LoopedSource

_PROGRESS_EVERY_S = 0.5


class ProcessCost(Struct, frozen=True, kw_only=True):
    """What the robot's process cost."""

    cpu_s: float
    seconds: float
    rss_peak_bytes: int


class PlayedSummary(RunSummary, frozen=True, kw_only=True):
    """The summary of a run, and its cost."""

    process: ProcessCost


class _Progress:
    def __init__(self) -> None:
        self._last = 0.0

    def __call__(self, figures: RunProgress, *, last: bool = False) -> None:
        if last or time.monotonic() - self._last >= _PROGRESS_EVERY_S:
            self._last = time.monotonic()
            sys.stderr.write(msgspec.json.encode({"progress": figures}).decode() + "\n")
            sys.stderr.flush()


def read_peak_bytes(status: Path = Path("/proc/self/status")) -> int:
    """Without /proc (macOS) by `getrusage`, perhaps including its parent."""
    try:
        lines = split_lines(status.read_text(encoding="ascii", errors="replace"))
    except OSError:
        lines = []
    for line in lines:
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) * 1024
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


def _cpu_s() -> float:
    used = os.times()
    return used.user + used.system


async def _play(chosen: argparse.Namespace) -> PlayedSummary:
    source = LoopedSource(chosen.bag, load_topics(chosen.topics), loop_ms=chosen.loop_ms, frames=chosen.frames)
    options = ReplayOptions(
        roster=chosen.folder / "roster.sealed",
        purpose=chosen.purpose,
        clip_ms=CLIP_DEFAULT_MS,
        events=chosen.events,
        at_once=False,
        real_time=True,
        approver=PrivateKey(chosen.approver.read_bytes()),
    )
    started_s, cpu_before_s = time.monotonic(), _cpu_s()
    summary = await replay_recording(chosen.folder, source, load_genesis(chosen.genesis), options, _Progress())
    cost = ProcessCost(
        cpu_s=round(_cpu_s() - cpu_before_s, 3),
        seconds=round(time.monotonic() - started_s, 3),
        rss_peak_bytes=read_peak_bytes(),
    )
    return extend(PlayedSummary, summary, process=cost)


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="network.bench.robot.robot_player")
    for name in ("--folder", "--genesis", "--bag", "--events", "--approver"):
        parser.add_argument(name, type=Path, required=True)
    for name in ("--loop-ms", "--frames"):
        parser.add_argument(name, type=int, required=True)
    parser.add_argument("--topics", type=Path)
    parser.add_argument("--purpose", required=True)
    parser.add_argument("--json", action="store_true")
    try:
        answer: PlayedSummary | dict[str, object] = asyncio.run(_play(parser.parse_args(arguments)))
    except BlockRobotError as error:
        answer = {"error": {"code": error.code, "detail": error.detail}}
    sys.stdout.write(msgspec.json.encode(answer).decode() + "\n")


if __name__ == "__main__":
    main()

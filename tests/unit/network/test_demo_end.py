"""A demonstration whose machine is too slow says so, and leaves nothing running."""

from __future__ import annotations

import asyncio
import threading
from pathlib import Path
from typing import Any

import pytest

from clients.robot.run.run_summary import RunSummary
from consensus.errors import BlockRobotError
from network.demo import story
from network.demo.checks import CheckList
from network.demo.processes import LongCommand
from network.demo.story import Demo, DemoOptions

WAIT_MAX_S = 60.0


async def test_nothing_is_rendered_on_once_the_network_did_not_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, over, ended = threading.Event(), threading.Event(), list[BlockRobotError]()

    def render(*_: Any, progress: Any) -> None:
        begun.set()
        over.wait(WAIT_MAX_S)
        try:
            progress(1, 2)
        except BlockRobotError as error:
            ended.append(error)

    async def fail() -> None:
        await asyncio.to_thread(begun.wait, WAIT_MAX_S)
        raise BlockRobotError("CLUSTER_START_FAILED", "Not ready in time: node-2.")

    checks = CheckList(listener=lambda _: None)
    options = DemoOptions(out=tmp_path / "demo", cache=tmp_path, store="sqlite", base_port=20_000, keep=False)
    demo = Demo(options, checks, lambda _: None)
    monkeypatch.setattr(demo, "start_network", fail)
    monkeypatch.setattr(story, "make_bag", render)
    await demo.run()
    over.set()
    await asyncio.get_running_loop().shutdown_default_executor()
    assert len(ended) == 1
    (failed,) = checks.checks
    assert not failed.ok
    assert "CLUSTER_START_FAILED: Not ready in time: node-2." in failed.detail
    assert "the machine is too slow or too busy" in failed.detail


async def test_a_command_that_takes_too_long_is_no_fault_of_the_program() -> None:
    command = LongCommand(["robot"], RunSummary, lambda _: None)
    with pytest.raises(BlockRobotError, match=r"^COMMAND_TOO_SLOW: `blockrobot robot` did not end in 0 s; .* cores"):
        await command.run(0.0)

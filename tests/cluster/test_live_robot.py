"""A live robot on real nodes is told to end: what it saw is recorded, its visits are closed, and nothing waits."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import sys
from pathlib import Path

from clients.robot.identity.robot_keys import load_identity
from clients.robot.recording.unclosed_visit_store import UnclosedVisitStore
from tests.cluster.killed_robot import PURPOSE, ROOT, SCENE_FILE, killed_robot
from tests.cluster.network_under_test import NetworkUnderTest

SEEN_COUNT = 12
END_TIMEOUT_S = 60


async def test_ctrl_c_ends_a_live_run_with_everything_sealed_recorded_and_closed(
    network: NetworkUnderTest, tmp_path: Path
) -> None:
    async with killed_robot(network, tmp_path) as robot:
        process = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "network.cli.main", "robot", "--robot-dir", str(robot.robot.parent)),
            *("--genesis", str(network.folder / "genesis.json"), "run", "--scenario", str(tmp_path / SCENE_FILE)),
            *robot.approved,
            *("--purpose", PURPOSE, "--json"),
            cwd=ROOT,
            env={**os.environ, "BLOCKROBOT_HOME": str(tmp_path)},
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
        )
        assert process.stderr is not None
        try:
            async with asyncio.timeout(END_TIMEOUT_S):
                async for line in process.stderr:
                    if line.startswith(b"{") and json.loads(line)["progress"]["frames_read"] >= SEEN_COUNT:
                        break
                process.send_signal(signal.SIGINT)
                output, _ = await process.communicate()
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
        summary = json.loads(output)
        reports = await robot.read()

        assert (process.returncode, summary["ok"]) == (0, True)
        frames = summary["frames"]
        assert frames["published"] >= SEEN_COUNT
        assert frames["kept"] + frames["withheld"] == frames["covered"] > 0
        assert [(report.closed, report.missing_count) for report in reports] == [(True, 0)] * len(reports)
        held = [entry.metadata for report in reports for entry in report.records]
        assert sum(entry.frame_count for entry in held if entry.sensor == "depth") == frames["kept"] > 0
        assert list((robot.robot / "spool").iterdir()) == []
        assert UnclosedVisitStore(robot.robot / "open-visits", load_identity(robot.robot).spool).counts == {}
        assert [path.name for path in (tmp_path / "recordings").iterdir()] == ["tags.json"], "what it saw is not kept"
        robot.look_at_disk()

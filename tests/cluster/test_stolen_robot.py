"""A robot is stolen while it records: its key file is sealed, and at the desk its membership ends for good."""

from __future__ import annotations

import asyncio
import json
import os
import sys
from asyncio.subprocess import PIPE, Process
from pathlib import Path

from tests.cluster.killed_robot import PURPOSE, ROOT, SCENE_FILE, killed_robot
from tests.cluster.network_under_test import NetworkUnderTest

SEEN_COUNT = 12
END_TIMEOUT_S = 60


async def command(home: Path, *arguments: str) -> Process:
    return await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "network.cli.main", *arguments, "--json"),
        cwd=ROOT,
        env={**os.environ, "BLOCKROBOT_HOME": str(home)},
        stdin=asyncio.subprocess.DEVNULL,
        stdout=PIPE,
        stderr=PIPE,
    )


async def done(process: Process) -> tuple[int | None, dict[str, object]]:
    output, said = await asyncio.wait_for(process.communicate(), END_TIMEOUT_S)
    assert output, said.decode()[-2_000:]
    return process.returncode, json.loads(output)


async def test_a_stolen_robot_is_revoked_at_the_desk_and_records_no_more(
    network: NetworkUnderTest, tmp_path: Path
) -> None:
    async with killed_robot(network, tmp_path) as robot:
        genesis, secret = str(network.folder / "genesis.json"), tmp_path / "passphrase"
        secret.write_text("tea and lemon cake")
        desk = ("--registrar-dir", str(network.folder / "organisations" / network.genesis.organisations[0].name))
        base = ("robot", "--robot-dir", str(robot.robot.parent), "--genesis", genesis)
        run = ("run", "--scenario", str(tmp_path / SCENE_FILE), "--purpose", PURPOSE, *robot.approved)
        sealed = await done(await command(tmp_path, *base, "passphrase", "--new-file", str(secret)))
        assert sealed == (0, {"ok": True, "sealed": True})
        _, refused = await done(await command(tmp_path, *base, *run))
        assert refused["error"]["code"] == "ROBOT_PASSPHRASE_MISSING"

        process = await command(tmp_path, *base, "--passphrase-file", str(secret), *run)
        assert process.stderr is not None
        try:
            async with asyncio.timeout(END_TIMEOUT_S):
                async for line in process.stderr:
                    if (
                        line.startswith(b"{")
                        and json.loads(line).get("progress", {}).get("frames_read", 0) >= SEEN_COUNT
                    ):
                        break
            (tmp_path / "robot-uid").write_text("0BADF00D")
            revoke = ("card", "revoke", *desk, "--genesis", genesis, "--uid-file", str(tmp_path / "robot-uid"))
            _, asked = await done(await command(tmp_path, *revoke))
            assert asked["error"]["code"] == "USAGE_INVALID", "nobody is there to be asked"
            code, ended = await done(await command(tmp_path, *revoke, "--yes"))
            assert (code, ended["ok"], ended["role"]) == (0, True, "robot")
            code, summary = await done(process)
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()
        assert code != 0
        assert summary["ok"] is False
        member = (await done(await command(tmp_path, *revoke, "--yes")))[1]
        assert member["error"]["code"] == "NOT_FOUND"
        again = await done(await command(tmp_path, *base, "--passphrase-file", str(secret), *run))
        assert again[0] != 0
        assert "robot-uid" not in {path.name for path in robot.robot.iterdir()}

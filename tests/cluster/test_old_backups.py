"""A producer's data directory is put back from a backup: it says nothing until it is safe, and then takes part again.

The field's incidents: a sign state that rolled back makes conflicting votes (cometbft#6031), a producer signs twice after
a forced kill (bsc#2598), a lost safety file keeps a finalizer from voting for ever (spring#456, leap#2070).
"""

from __future__ import annotations

import asyncio
import shutil
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from network.faults.actions import Kill, Restart
from tests.cluster.commands import must
from tests.cluster.network_under_test import NetworkUnderTest, running
from tests.cluster.story import Story

RETURN_TIMEOUT_S = 60.0


@pytest.fixture
async def network(tmp_path: Path) -> AsyncIterator[NetworkUnderTest]:
    async with running(NetworkUnderTest(tmp_path / "network", nodes=4)) as under_test:
        yield under_test


async def _work(network: NetworkUnderTest, name: str, count: int) -> None:
    for _ in range(count):
        await network.finalize(name, network.transaction())


async def _lockout(network: NetworkUnderTest, name: str) -> dict[str, Any] | None:
    """What the node says of its lockout, once it answers."""
    deadline = time.monotonic() + RETURN_TIMEOUT_S
    while "lockout" not in (status := await network.status(name)):
        assert time.monotonic() < deadline, f"{name} did not answer"
        await asyncio.sleep(0.05)
    lockout: dict[str, Any] | None = status["lockout"]
    return lockout


async def _until_it_speaks(network: NetworkUnderTest, name: str, others: str) -> int:
    """Work at another node until this one signs again; return how many transactions that took."""
    deadline = time.monotonic() + RETURN_TIMEOUT_S
    count = 0
    while await _lockout(network, name) is not None:
        assert time.monotonic() < deadline, f"{name} is locked out for ever"
        await _work(network, others, 1)
        count += 1
    return count


async def _require_its_votes(network: NetworkUnderTest, name: str, dead: str) -> None:
    """With one of the others dead, nothing becomes final without this node's votes."""
    network.cluster.kill(dead)
    await _work(network, name, 2)


@pytest.mark.parametrize("is_flagged", [True, False], ids=["flagged", "unflagged"])
async def test_an_old_machine_comes_back_under_load_and_never_speaks_against_itself(
    story: Story, is_flagged: bool
) -> None:
    """The whole directory is put back. With the flag it is certain to be locked out; without it, the others tell it."""
    name, config = "node-4", story.cluster.config("node-4")
    await story.work("node-1", "node-2", "node-3")
    await story.until_told(10)
    await asyncio.to_thread(story.cluster.stop, name)
    backup = shutil.copytree(config.data_dir, config.data_dir.with_name("backup"))
    story.cluster.start(name)
    await story.cluster.wait_ready([name])
    await story.until_told(20)
    killed_s = await story.do(Kill(name))
    shutil.rmtree(config.data_dir)
    backup.rename(config.data_dir)
    story.cluster.start(name, restored=is_flagged)
    await story.wait_until(name, lambda said: bool(said.get("ready")) and said["lockout"] is None, RETURN_TIMEOUT_S)
    story.report_gap("old_machine", killed_s)
    assert ('"restored"' if is_flagged else '"outdated"') in config.log_path.read_text(encoding="utf-8")
    dead_s = await story.do(Kill("node-2"))
    await story.until_told(5)
    story.report_gap("needing_its_votes", dead_s)
    await story.do(Restart("node-2"))
    await story.cluster.wait_ready(["node-2"])
    listed = await must(story.network, "producer", "list")
    assert [row["status"] for row in listed["producers"]] == ["producing"] * 4
    assert not any(row["evidence"] for row in listed["producers"])
    await story.end()


async def test_an_old_journal_is_noticed_by_what_the_others_remember(network: NetworkUnderTest) -> None:
    """Nobody gave the flag. The ledger beside the journal is the newest one."""
    name, journal = "node-3", network.cluster.config("node-3").journal_path
    await _work(network, "node-1", 2)
    old = journal.read_bytes()
    await _work(network, "node-1", 4)
    network.cluster.kill(name)
    journal.write_bytes(old)
    network.cluster.start(name)
    lockout = await _lockout(network, name)
    assert lockout is not None
    assert lockout["reason"] in ("asking", "outdated")
    await _until_it_speaks(network, name, "node-1")
    assert '"outdated"' in network.cluster.config(name).log_path.read_text()
    await _require_its_votes(network, name, "node-2")


async def test_a_lost_journal_starts_with_the_flag_only(network: NetworkUnderTest) -> None:
    name, config = "node-2", network.cluster.config("node-2")
    await _work(network, "node-1", 3)
    network.cluster.kill(name)
    config.journal_path.unlink()
    network.cluster.start(name)
    deadline = time.monotonic() + RETURN_TIMEOUT_S
    while network.cluster.is_running(name):
        assert time.monotonic() < deadline
        await asyncio.sleep(0.05)
    output = (config.data_dir / "output.log").read_text()
    assert "JOURNAL_MISSING" in output
    assert "--restored" in output
    config.journal_dir.rmdir()
    network.cluster.start(name, restored=True)
    await _until_it_speaks(network, name, "node-1")
    network.cluster.kill(name)
    network.cluster.start(name)
    await _require_its_votes(network, name, "node-4")

"""Kills the leader during recording and measures the gap in finality."""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass

from network.cluster import Cluster

RESTART_AFTER_S = 6.0
_POLL_S = 0.03
_WATCH_S = 4.0


@dataclass(frozen=True, slots=True)
class LeaderKill:
    """The node killed, length of the finality gap, and whether it caught up."""

    name: str
    finalized_height_before: int
    gap_s: float
    caught_up: bool
    catch_up_s: float


async def _finalized(cluster: Cluster, *, without: str = "") -> dict[str, int]:
    reports = await cluster.status()
    return {
        report.name: int(report.status["finalized_height"])
        for report in reports
        if report.status is not None and report.name != without
    }


async def find_leader(cluster: Cluster) -> str:
    reports = await cluster.status()
    votes = [str(report.status["leader"]) for report in reports if report.status and report.status.get("leader")]
    return max(set(votes), key=votes.count) if votes else cluster.names[0]


async def kill_and_restart_leader(cluster: Cluster) -> LeaderKill:
    name = await find_leader(cluster)
    before = max((await _finalized(cluster)).values())
    cluster.kill(name)
    gap_s = await _watch_gap(cluster, name)
    await asyncio.sleep(max(0.0, RESTART_AFTER_S - _WATCH_S))
    cluster.start(name)
    started = time.monotonic()
    await cluster.wait_ready([name])
    caught_up = await _wait_caught_up(cluster, name)
    return LeaderKill(
        name=name,
        finalized_height_before=before,
        gap_s=round(gap_s, 3),
        caught_up=caught_up,
        catch_up_s=round(time.monotonic() - started, 3),
    )


async def _watch_gap(cluster: Cluster, killed: str) -> float:
    last_height = max((await _finalized(cluster, without=killed)).values())
    waiting_since: float | None = time.monotonic()
    started = time.monotonic()
    longest = 0.0
    while time.monotonic() - started < _WATCH_S:
        await asyncio.sleep(_POLL_S)
        alive = [report.status for report in await cluster.status() if report.status and report.name != killed]
        height = max((int(status["finalized_height"]) for status in alive), default=last_height)
        waiting = any(int(status["mempool"]) > 0 for status in alive)
        now = time.monotonic()
        if waiting_since is not None:
            longest = max(longest, now - waiting_since)
        if height > last_height or not waiting:
            last_height, waiting_since = max(height, last_height), None
        if waiting and waiting_since is None:
            waiting_since = now
    return longest


async def _wait_caught_up(cluster: Cluster, name: str, timeout_s: float = 30.0) -> bool:
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        heights = await _finalized(cluster)
        if name in heights and heights[name] >= max(heights.values()) - 2:
            return True
        await asyncio.sleep(_POLL_S)
    return False

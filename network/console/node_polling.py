"""Polls every node: process, status, faults and frame counts."""

from __future__ import annotations

import asyncio
import re
import time
from collections.abc import AsyncIterable, Mapping
from dataclasses import dataclass
from typing import Any

import aiohttp

from network.cluster import Cluster, NodeStatusReport
from network.faults.control import FaultControl, NodeFaults
from node.config import OPERATOR_HOST, NodeConfig, reading_headers

ANSWER_S = 1.0
METRICS_MAX_BYTES = 1 << 20
_BYTES = "blockrobot_peer_bytes_total"
_COUNT = re.compile(
    r'^(blockrobot_peer_frames_total|blockrobot_peer_bytes_total)\{peer="([^"\\]*)",direction="(sent|received)",'
    r'kind="([a-z_]+)"\} (\d+)$',
    re.MULTILINE,
)

Counts = Mapping[tuple[str, str, str], tuple[int, int]]
"""(peer, `sent` or `received`, kind) -> (frames, bytes) since the node's start."""


@dataclass(frozen=True, slots=True)
class NodePoll:
    """Result of one poll of a node. None: not reported; `clock_off_ms`: minimal clock error."""

    name: str
    running: bool
    paused: bool
    status: Mapping[str, Any] | None
    behaviour: str = ""
    switched: Mapping[str, Any] | None = None
    faults: tuple[str, ...] = ()
    counts: Counts | None = None
    clock_off_ms: int | None = None


def parse_counts(text: str) -> dict[tuple[str, str, str], tuple[int, int]]:
    found: dict[tuple[str, str, str], list[int]] = {}
    for name, peer, direction, kind, count in _COUNT.findall(text):
        found.setdefault((peer, direction, kind), [0, 0])[name == _BYTES] = int(count)
    return {key: (frames, size) for key, (frames, size) in found.items()}


class NodePoller:
    """Polls all nodes of a cluster concurrently. `async with`."""

    def __init__(self, cluster: Cluster) -> None:
        self._cluster = cluster
        self._control = FaultControl(cluster)
        self._session: aiohttp.ClientSession | None = None

    async def __aenter__(self) -> NodePoller:
        self._session = aiohttp.ClientSession(timeout=aiohttp.ClientTimeout(total=ANSWER_S))
        return self

    async def __aexit__(self, *exception: object) -> None:
        if self._session is not None:
            await self._session.close()

    async def poll(self) -> list[NodePoll]:
        cluster = self._cluster
        started_ms = time.time_ns() // 1_000_000
        reports, faults, counts = await asyncio.gather(
            cluster.status(timeout_s=ANSWER_S),
            self._control.state(),
            asyncio.gather(*(self._counts(cluster.config(name)) for name in cluster.names)),
        )
        asked = _Span(started_ms, time.time_ns() // 1_000_000)
        return [
            _sight(report, fault, count, asked) for report, fault, count in zip(reports, faults, counts, strict=True)
        ]

    async def _counts(self, config: NodeConfig) -> Counts | None:
        if self._session is None:
            raise RuntimeError("looking has not begun")
        try:
            url, headers = f"http://{OPERATOR_HOST}:{config.operator_port}/metrics", reading_headers(config)
            async with self._session.get(url, headers=headers) as response:
                text = await _read_whole(response.content.iter_any())
        except (aiohttp.ClientError, TimeoutError, OSError):
            return None
        return parse_counts(text.decode("utf-8", "replace"))


async def _read_whole(body: AsyncIterable[bytes]) -> bytes:
    """In however many pieces; empty if over the limit."""
    pieces, size = [], 0
    async for piece in body:
        pieces.append(piece)
        size += len(piece)
        if size > METRICS_MAX_BYTES:
            return b""
    return b"".join(pieces)


@dataclass(frozen=True, slots=True)
class _Span:
    """Start and end of a poll: each answer was given in between."""

    from_ms: int
    to_ms: int

    def off_ms(self, clock_ms: int) -> int:
        return min(0, clock_ms - self.from_ms) or max(0, clock_ms - self.to_ms)


def _sight(report: NodeStatusReport, faults: NodeFaults, counts: Counts | None, asked: _Span) -> NodePoll:
    status = report.status
    clock_ms = None if status is None else status.get("now_ms")
    return NodePoll(
        name=report.name,
        running=report.running,
        paused=faults.paused,
        status=status,
        behaviour=faults.behaviour,
        switched=faults.switched,
        faults=tuple(word for word in faults.describe() if word not in {"down", "paused"}),
        counts=None if status is None else counts,
        clock_off_ms=None if clock_ms is None else asked.off_ms(int(clock_ms)),
    )

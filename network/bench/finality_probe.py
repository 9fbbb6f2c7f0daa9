"""Submits steady calls to one node and records when each is final."""

from __future__ import annotations

import asyncio
import itertools
import time
from collections.abc import Sequence
from types import TracebackType

from consensus.chain.genesis import Genesis, NodeEntry
from consensus.errors import BlockRobotError
from network.bench.event_follower import FinalityFollower
from network.bench.fresh_network import LoadRobot

INTERVAL_MS = 20
SETTLE_TIMEOUT_S = 20.0


def longest_gap_s(finals_s: Sequence[float], from_s: float, until_s: float) -> float:
    """Longest time between events (s); both ends count as events."""
    inside = sorted(moment for moment in finals_s if from_s < moment < until_s)
    return max(later - earlier for earlier, later in itertools.pairwise([from_s, *inside, until_s]))


class FinalityProbe:
    """Robot submitting one call per `INTERVAL_MS` while open; use as `async with`."""

    def __init__(self, genesis: Genesis, node: NodeEntry, robot: LoadRobot) -> None:
        self._robot = robot
        self._follower = FinalityFollower(genesis, node, robot.key)
        self._task: asyncio.Task[None] | None = None
        self._waiting: dict[bytes, asyncio.Future[float]] = {}
        self.finals_s: list[float] = []
        self.acknowledged_count = 0
        self.errors: dict[str, int] = {}

    async def __aenter__(self) -> FinalityProbe:
        await self._follower.__aenter__()
        self._task = asyncio.create_task(self._submit_steadily(), name="finality-probe")
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self._stop_submitting()
        await self._follower.__aexit__(kind, error, trace)

    async def _stop_submitting(self) -> None:
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)
            self._task = None

    async def _submit_steadily(self) -> None:
        while True:
            transaction = self._robot.sign_record()
            self._waiting |= self._follower.expect([transaction.txid])
            self._waiting[transaction.txid].add_done_callback(self._note)
            try:
                (refusal,) = await self._robot.client.submit_batch([transaction])
            except BlockRobotError as error:
                refusal = error
            if refusal is None:
                self.acknowledged_count += 1
            else:
                self.errors[refusal.code] = self.errors.get(refusal.code, 0) + 1
                self._follower.forget(transaction.txid)
                self._waiting.pop(transaction.txid).cancel()
            await asyncio.sleep(INTERVAL_MS / 1000)

    def _note(self, future: asyncio.Future[float]) -> None:
        if not future.cancelled():
            self.finals_s.append(future.result())

    async def wait_final_after(self, moment_s: float, timeout_s: float) -> float | None:
        """A `time.perf_counter` moment; None on timeout."""
        while time.perf_counter() < moment_s + timeout_s:
            after = [final for final in self.finals_s if final > moment_s]
            if after:
                return min(after)
            await asyncio.sleep(INTERVAL_MS / 4000)
        return None

    async def settle(self) -> int:
        """Wait for acknowledged calls; return how many never became final."""
        await self._stop_submitting()
        pending = [future for future in self._waiting.values() if not future.done()]
        if pending:
            await asyncio.wait(pending, timeout=SETTLE_TIMEOUT_S)
        return sum(not future.done() for future in self._waiting.values())

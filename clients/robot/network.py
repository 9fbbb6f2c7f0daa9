"""The robot's side of the network: signs, uploads to custodians, submits. Must never wait for one node alone."""

from __future__ import annotations

import asyncio
import time
from typing import Any

import structlog

from clients.robot.hiding.background import EmptyFrame
from clients.robot.identity import RobotIdentity
from clients.sdk.http import FinalReceipt, NetworkClient
from clients.sdk.transactions import TransactionBuilder
from consensus.errors import BlockRobotError
from consensus.records.clips import ClipUpload
from consensus.transaction import Transaction

ACKNOWLEDGEMENTS_COUNT = 2

_log = structlog.get_logger("robot")


class RobotNetwork:
    """What delivery needs, over the client library."""

    def __init__(self, client: NetworkClient, identity: RobotIdentity) -> None:
        self._client = client
        self._identity = identity
        self._transactions = TransactionBuilder(client.genesis.chain_id)
        self._custodians = [node.name for node in client.genesis.custodians]
        self._required = min(ACKNOWLEDGEMENTS_COUNT, len(self._custodians))

    def now_ms(self) -> int:
        """The wall clock in milliseconds."""
        return time.time_ns() // 1_000_000

    def sign(self, contract: str, entry: str, arguments: list[Any]) -> Transaction:
        """Sign a call as the robot."""
        return self._transactions.sign(self._identity.identity, contract, entry, arguments)

    async def submit_and_wait(self, transaction: Transaction) -> FinalReceipt:
        """Submit and wait until the transaction is final."""
        return await self._client.submit_and_wait(transaction)

    async def upload(self, upload: ClipUpload) -> None:
        """Bring a clip to all custodians. Raises the last refusal if fewer than two (or all there are) took it."""
        await self._to_custodians(
            lambda name: self._client.upload_clip(name, upload, self._identity.identity), self._required
        )

    async def publish_empty_frames(self, frames: tuple[EmptyFrame, ...]) -> None:
        """Bring the recorded empty frames, which show nobody, to all custodians."""
        for frame in frames:
            await self._to_custodians(
                lambda name, frame=frame: self._client.put_background(name, frame.png, self._identity.identity),
                self._required,
            )

    async def _to_custodians(self, send: Any, required: int) -> None:
        results = await asyncio.gather(*(send(name) for name in self._custodians), return_exceptions=True)
        refusals = [result for result in results if isinstance(result, BaseException)]
        for refusal in refusals:
            if not isinstance(refusal, BlockRobotError):
                raise refusal
        if len(results) - len(refusals) < required:
            _log.warning("upload_refused", count=len(refusals))
            raise refusals[-1]

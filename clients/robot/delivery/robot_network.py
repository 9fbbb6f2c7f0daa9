"""Robot's network side: signing, uploads (awaiting the answer of every keeper), submission."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable, Sequence
from functools import partial
from typing import Any

import structlog

from clients.robot.delivery.delivery import CUSTODIANS_WORD, Whose
from clients.robot.hiding.background import EmptyFrame
from clients.robot.identity.robot_keys import RobotIdentity
from clients.sdk.chain.empty_frames import approve_frames, read_approved
from clients.sdk.chain.proved_rows import in_session, proved_row
from clients.sdk.chain.receipts import FinalReceipt
from clients.sdk.connections import NodeAddress
from clients.sdk.network_client import NetworkClient
from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from consensus.records.clips import ClipUpload
from consensus.state.records import RECORD, VISIT, RecordRow, VisitRow

COPIES_DEFAULT_COUNT = 2
COPIES_MAX_COUNT = 16
_AWAY_CODES = frozenset({"NODE_UNREACHABLE", "STORE_UNAVAILABLE", "DISK_RESERVE_REACHED", "ERASE_KEYS_DAMAGED"})
"""Of a custodian that takes no uploads, whatever they are: told once."""

_log = structlog.get_logger("robot")


class RobotNetwork:
    """Uploads need `copies` acknowledgements, or as many as keep a clip if these are fewer."""

    def __init__(self, client: NetworkClient, identity: RobotIdentity, copies: int = COPIES_DEFAULT_COUNT) -> None:
        self._client = client
        self._copies = copies
        self._identity = identity
        self.refused_uploads: Counter[str] = Counter()
        """How often a custodian took no upload, by the code with which it refused or could not be reached."""
        self._away: dict[str, str] = {}  # codes by custodian

    def now_ms(self) -> int:
        return self._client.clock.now_ms()

    def sign(self, contract: str, entry: str, arguments: list[Any]) -> Transaction:
        return self._client.transactions.build(self._identity.identity, contract, entry, arguments)

    async def submit_and_wait(self, transaction: Transaction) -> FinalReceipt:
        return await self._client.submit_and_wait(transaction)

    async def robot_of_visit(self, owner: bytes) -> Whose:
        """The node learns the owner key."""
        visit = await proved_row(in_session(self._client, self._identity.identity), VISIT, owner)
        return self._whose(visit)

    async def robot_of_record(self, record_id: bytes) -> Whose:
        record = await proved_row(in_session(self._client, self._identity.identity), RECORD, record_id)
        return self._whose(record)

    def _whose(self, row: VisitRow | RecordRow | None) -> Whose:
        if row is None:
            return "none"
        return "this" if row.robot == self._identity.identity.public_key else "another"

    async def upload(self, upload: ClipUpload) -> None:
        """To the clip's keepers, and to others while too few of them take it: a keeper fetches it from these once it is
        back. Raises if too few acknowledged: what nothing can mend only if nobody took it.
        """
        await self._client.find_nodes(self._identity.identity)
        keepers, others = self._client.custody.rank(upload.record_id)
        await self._send(
            lambda node: self._client.custody.upload_clip(node, upload, self._identity.identity), keepers, others
        )

    async def approve_empty_frames(self, frames: tuple[EmptyFrame, ...], approver: PrivateKey) -> None:
        robot = self._identity.identity.public_key
        await approve_frames(self._client, approver, robot, [frame.background_id for frame in frames])

    async def find_unapproved(self, frames: tuple[EmptyFrame, ...]) -> list[EmptyFrame]:
        identity = self._identity.identity
        approved = {frame.digest for frame in await read_approved(self._client, identity.public_key, identity)}
        return [frame for frame in frames if frame.background_id not in approved]

    async def publish_empty_frames(self, frames: tuple[EmptyFrame, ...]) -> None:
        for frame in frames:
            await self._client.find_nodes(self._identity.identity)
            await self._send(partial(self._put_background, frame.png), self._client.custody.custodians)

    async def _put_background(self, png: bytes, node: NodeAddress) -> None:
        await self._client.custody.put_background(node, png, self._identity.identity)

    async def _send(
        self,
        send: Callable[[NodeAddress], Awaitable[object]],
        custodians: Sequence[NodeAddress],
        instead: Sequence[NodeAddress] = (),
    ) -> None:
        wanted = min(self._copies, len(custodians))
        refusals = await self._send_to_each(send, custodians)
        lacking, left = wanted - (len(custodians) - len(refusals)), list(instead)
        while lacking > 0 and left:
            others, left = left[:lacking], left[lacking:]
            refused = await self._send_to_each(send, others)
            refusals += refused
            lacking -= len(others) - len(refused)
        if lacking > 0:
            raise _choose_refusal(refusals, is_taken=lacking < wanted)

    async def _send_to_each(
        self, send: Callable[[NodeAddress], Awaitable[object]], nodes: Sequence[NodeAddress]
    ) -> list[BlockRobotError]:
        results = await asyncio.gather(*(send(node) for node in nodes), return_exceptions=True)
        refusals = []
        for node, refusal in zip(nodes, results, strict=True):
            if isinstance(refusal, BlockRobotError):
                self.refused_uploads[refusal.code] += 1
                refusals.append(refusal)
                if refusal.code in _AWAY_CODES and self._away.get(node.name) != refusal.code:
                    self._away[node.name] = refusal.code
                    _log.warning("custodian_takes_no_uploads", custodian=node.name, code=refusal.code)
            elif isinstance(refusal, BaseException):
                raise refusal
            elif self._away.pop(node.name, ""):
                _log.info("custodian_takes_uploads_again", custodian=node.name)
        return refusals


def _choose_refusal(refusals: Sequence[BlockRobotError], *, is_taken: bool) -> BlockRobotError:
    """Whoever lies alone must not end a run: what can be asked of the chain first, then what may pass."""
    for refusal in refusals:
        if refusal.code in CUSTODIANS_WORD:
            return refusal
    for refusal in refusals:
        if refusal.entry.retryable:
            return refusal
    if is_taken:
        detail = f"Some custodians took it, another said {refusals[-1].code}."
        return BlockRobotError("STORE_UNAVAILABLE", detail)
    return refusals[-1]

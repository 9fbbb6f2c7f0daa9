"""Ties the custodian to the chain: feeds it finalized blocks, submits what it owes, moves clips between custodians.

Must never hand the custodian a block that is not final, nor leave one out: it goes on from the custodian's own
checkpoint, so that a crash at any moment repeats a block at most, and the custodian's writes are idempotent.
"""

from __future__ import annotations

import asyncio
import secrets
from collections import OrderedDict
from collections.abc import Callable, Sequence
from typing import Protocol

import structlog

from consensus.block import Block, Header, Receipt, Receipts
from consensus.errors import BlockRobotError
from consensus.genesis import Genesis
from consensus.limits import CLIP_SIZE_MAX_BYTES
from consensus.primitives.encoding import decode, decode_value, encode
from consensus.primitives.keys import PrivateKey
from consensus.records.clips import ClipUpload
from consensus.transaction import SALT_SIZE_BYTES, Transaction, sign_transaction
from contracts.state.view import StateReader
from node.api.services import TransactionPool
from node.finality import FinalityFeed
from node.offchain.store import Checkpoint, OutboxRow, RecordFacts
from node.p2p.wire import ClipPart, ClipRequest, RequestKind
from node.storage.ledger_store import LedgerStore

OUTBOX_BATCH_COUNT = 64
OUTBOX_INTERVAL_MS = 1_000
OUTBOX_LIFETIME_MS = 60_000
FETCH_INTERVAL_MS = 2_000
FETCH_BATCH_COUNT = 16
CLIP_PART_BYTES = 1024 * 1024
CLIP_WIRE_MAX_BYTES = CLIP_SIZE_MAX_BYTES + 1024 * 1024
CLIPS_SERVED_KEPT_COUNT = 2
RETRY_MS = 500
_WAIT_MS = 60_000

log = structlog.get_logger(__name__)


class Custodian(Protocol):
    """What is asked of the custodian (`node.offchain.custodian`)."""

    async def checkpoint(self) -> Checkpoint | None:
        """Return the newest block whose effects are in the store."""
        ...

    async def on_finalized(
        self, header: Header, block_id: bytes, receipts: Sequence[Receipt], state: StateReader
    ) -> None:
        """Take one finalized block's effects over, with its checkpoint; `state` is the newest finalized one.

        Repeating a block is harmless. Raises STORE_UNAVAILABLE.
        """
        ...

    async def outbox(self, limit: int) -> Sequence[OutboxRow]:
        """Return transactions that are owed to the chain and may be submitted."""
        ...

    async def missing(self, limit: int) -> Sequence[RecordFacts]:
        """Return clips that the chain has and this custodian has not."""
        ...

    async def export_clip(self, record_id: bytes) -> ClipUpload | None:
        """Return a confirmed clip whole, for another custodian, or None."""
        ...

    async def import_clip(self, upload: ClipUpload) -> None:
        """Take a missing clip over from another custodian. Raises UPLOAD_* if it is not the chain's."""
        ...


class PeerRequests(Protocol):
    """Asks peers."""

    @property
    def connected(self) -> list[str]:
        """The names of the connected peers."""
        ...

    async def request(self, peer: str, kind: RequestKind, body: bytes) -> bytes:
        """Return the answer. Raises PEER_UNAVAILABLE."""
        ...


class Custody:
    """The custodian's work on this node, as three tasks: follow, submit, fetch."""

    def __init__(
        self,
        *,
        genesis: Genesis,
        name: str,
        custodian: Custodian,
        key: PrivateKey,
        ledger: LedgerStore,
        feed: FinalityFeed,
        pool: TransactionPool,
        peers: PeerRequests,
        clock: Callable[[], int],
    ) -> None:
        self._genesis = genesis
        self._custodian = custodian
        self._key = key
        self._ledger = ledger
        self._feed = feed
        self._pool = pool
        self._peers = peers
        self._clock = clock
        self._others = frozenset(node.name for node in genesis.custodians) - {name}
        self._submitted: dict[tuple[str, bytes, int], int] = {}
        self._served: OrderedDict[bytes, bytes] = OrderedDict()
        self._wake_outbox = asyncio.Event()
        self._tasks: list[asyncio.Task[None]] = []
        self.checkpoint_height: int | None = None

    async def start(self) -> None:
        """Read the checkpoint and begin. Raises STORE_UNAVAILABLE."""
        checkpoint = await self._custodian.checkpoint()
        self.checkpoint_height = None if checkpoint is None else checkpoint.height
        loop = asyncio.get_running_loop()
        for work in (self._follow, self._submit, self._fetch):
            self._tasks.append(loop.create_task(work(), name=f"custody{work.__name__}"))

    async def stop(self) -> None:
        """Stop; what was half done is done again after the next start."""
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    # Following the chain

    async def _follow(self) -> None:
        while True:
            height = -1 if self.checkpoint_height is None else self.checkpoint_height
            if height >= self._feed.height:
                await self._feed.wait_above(height, _WAIT_MS)
                continue
            try:
                await self._take_block(height + 1)
            except BlockRobotError as error:
                log.warning("custody_behind", height=height, code=error.code, detail=error.detail)
                await asyncio.sleep(RETRY_MS / 1000)
            except Exception:
                log.exception("custody_fault", height=height)
                await asyncio.sleep(RETRY_MS / 1000)

    async def _take_block(self, height: int) -> None:
        with self._ledger.snapshot() as snapshot:
            block_bytes, receipts_bytes = snapshot.block(height), snapshot.receipts(height)
            if block_bytes is None or receipts_bytes is None:
                raise BlockRobotError("STORAGE_DAMAGED", f"The ledger does not hold block {height}.")
            block = decode(block_bytes, Block)
            receipts = decode(receipts_bytes, Receipts).receipts
            await self._custodian.on_finalized(block.header, block.block_id, receipts, snapshot)
        self.checkpoint_height = height
        if any(receipt.ok and receipt.events for receipt in receipts):
            self._wake_outbox.set()

    # Submitting what is owed

    async def _submit(self) -> None:
        while True:
            try:
                await self._submit_due()
            except BlockRobotError as error:
                log.warning("outbox_waits", code=error.code, detail=error.detail)
            except Exception:
                log.exception("outbox_fault")
            try:
                async with asyncio.timeout(OUTBOX_INTERVAL_MS / 1000):
                    await self._wake_outbox.wait()
            except TimeoutError:
                continue
            finally:
                self._wake_outbox.clear()

    async def _submit_due(self) -> None:
        """Sign and submit the rows that are due, each again only after its last transaction expired unseen."""
        now_ms = self._clock()
        rows = await self._custodian.outbox(OUTBOX_BATCH_COUNT)
        owed = {row.key for row in rows}
        self._submitted = {key: until for key, until in self._submitted.items() if key in owed and until > now_ms}
        due = [row for row in rows if row.key not in self._submitted]
        if not due:
            return
        transactions = [self._sign(row, now_ms + OUTBOX_LIFETIME_MS) for row in due]
        results = await self._pool.submit([transaction.wire for transaction in transactions])
        for row, transaction, result in zip(due, transactions, results, strict=True):
            if result.error is None:
                self._submitted[row.key] = transaction.body.valid_until_ms
            else:
                log.warning("outbox_refused", kind=row.kind, code=result.error.code)

    def _sign(self, row: OutboxRow, valid_until_ms: int) -> Transaction:
        return sign_transaction(
            self._key,
            chain_id=self._genesis.chain_id,
            contract=row.contract,
            entry=row.entry,
            arguments=decode_value(row.arguments),
            valid_until_ms=valid_until_ms,
            salt=secrets.token_bytes(SALT_SIZE_BYTES),
        )

    # Clips between custodians

    async def serve_peer(self, peer: str, kind: RequestKind, body: bytes) -> bytes:
        """Answer another custodian's request for a clip, part by part. Raises PEER_REFUSED or NOT_FOUND."""
        if peer not in self._others:
            raise BlockRobotError("PEER_REFUSED", f"{peer} is no custodian of this network.")
        if kind is not RequestKind.CLIP:
            raise BlockRobotError("NOT_FOUND")
        request = decode(body, ClipRequest)
        data = self._served.get(request.record_id)
        if data is None or request.offset == 0:
            upload = await self._custodian.export_clip(request.record_id)
            data = b"" if upload is None else encode(upload)
            self._served[request.record_id] = data
            while len(self._served) > CLIPS_SERVED_KEPT_COUNT:
                self._served.popitem(last=False)
        part = data[request.offset : request.offset + CLIP_PART_BYTES] if request.offset >= 0 else b""
        if request.offset + len(part) >= len(data):
            self._served.pop(request.record_id, None)
        return encode(ClipPart(total=len(data), data=part))

    async def _fetch(self) -> None:
        while True:
            try:
                for facts in await self._custodian.missing(FETCH_BATCH_COUNT):
                    await self._fetch_clip(facts.record_id)
            except BlockRobotError as error:
                log.warning("clip_fetch_failed", code=error.code, detail=error.detail)
            except Exception:
                log.exception("clip_fetch_fault")
            await asyncio.sleep(FETCH_INTERVAL_MS / 1000)

    async def _fetch_clip(self, record_id: bytes) -> None:
        """Ask the other custodians for a clip until one has the right one."""
        for peer in sorted(self._others & set(self._peers.connected)):
            try:
                data = await self._download(peer, record_id)
                if data:
                    await self._custodian.import_clip(decode(data, ClipUpload))
                    log.info("clip_fetched", peer=peer)
                    return
            except BlockRobotError as error:
                log.warning("clip_fetch_failed", peer=peer, code=error.code, detail=error.detail)

    async def _download(self, peer: str, record_id: bytes) -> bytes:
        """Return a clip's canonical bytes from one peer, nothing if it has none. Raises PEER_*."""
        data = bytearray()
        while True:
            request = ClipRequest(record_id=record_id, offset=len(data))
            part = decode(await self._peers.request(peer, RequestKind.CLIP, encode(request)), ClipPart)
            if part.total > CLIP_WIRE_MAX_BYTES or (not part.data and len(data) < part.total):
                raise BlockRobotError("PEER_MESSAGE_INVALID", "The peer's clip is not what it announced.")
            data += part.data
            if len(data) >= part.total:
                return bytes(data)

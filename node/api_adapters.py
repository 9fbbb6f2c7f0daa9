"""Implements the Protocols of `node.api.ports` over the node."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import msgspec

from consensus.chain.block import Block, ContractEvent, FinalityProof, Header, Receipt, Receipts
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode
from consensus.primitives.trie import Proof
from node.api.explorer_documents import RoundDocument
from node.api.ports import Clock
from node.consensus.engine import Engine
from node.execution.block_executor import ExecutedBlock
from node.ledger.ledger_writer import FinalityFeed
from node.limits.token_buckets import OWN, Source
from node.mempool.call_check import CallCheck
from node.mempool.gossip import Gossip
from node.mempool.mempool import Mempool
from node.mempool.transaction_intake import Outcome, TransactionIntake
from node.mempool.transaction_pool import PoolStatus, SubmitResult
from node.storage.ledger_store import EventCursor, LedgerSnapshot, LedgerStore, Position
from node.storage.ledger_view import BlockHead, TransactionPlace

EXPIRED_REMEMBERED_MAX_COUNT = 16_384
LAGS_KEPT_COUNT = 1_024


class WallClock:
    """The machine's clock; `offset_ms` is a deliberate error (`node/faults.py`)."""

    def __init__(self) -> None:
        self.offset_ms = 0

    def now_ms(self) -> int:
        return time.time_ns() // 1_000_000 + self.offset_ms


class _BlockShape(msgspec.Struct, array_like=True, frozen=True):
    header_bytes: bytes
    signature: msgspec.Raw
    transactions: tuple[msgspec.Raw, ...]


class _ReceiptsShape(msgspec.Struct, array_like=True, frozen=True):
    receipts: tuple[msgspec.Raw, ...]


class _ReceiptShape(msgspec.Struct, array_like=True, frozen=True):
    txid: bytes


_read_shape = msgspec.msgpack.Decoder(_BlockShape).decode
_read_receipts_shape = msgspec.msgpack.Decoder(_ReceiptsShape).decode
_read_receipt_shape = msgspec.msgpack.Decoder(_ReceiptShape).decode


class DecodedSnapshot:
    """A ledger snapshot with blocks, receipts and proofs decoded."""

    def __init__(self, snapshot: LedgerSnapshot) -> None:
        self._snapshot = snapshot
        self._header: Header | None = None

    @property
    def header(self) -> Header:
        if self._header is None:
            position = self._snapshot.position
            head = None if position is None else self.head(position.height)
            if head is None or head.transactions_count is None:
                raise BlockRobotError("STORAGE_DAMAGED", "The ledger does not hold its newest block.")
            self._header = decode(head.header_bytes, Header)
        return self._header

    @property
    def finality(self) -> FinalityProof | None:
        data = self._snapshot.finality
        return decode(data, FinalityProof) if data else None

    def get(self, key: bytes) -> bytes | None:
        return self._snapshot.get(key)

    def scan(self, prefix: bytes, limit: int) -> Iterator[tuple[bytes, bytes]]:
        return self._snapshot.scan(prefix, limit)

    def scan_range(self, start: bytes, end: bytes) -> Iterator[tuple[bytes, bytes]]:
        return self._snapshot.scan_range(start, end)

    def prove(self, key: bytes) -> Proof:
        return self._snapshot.prove(key)

    def block(self, height: int) -> Block | None:
        data = self._snapshot.block(height)
        return None if data is None else decode(data, Block)

    def receipts(self, height: int) -> Sequence[Receipt] | None:
        data = self._snapshot.receipts(height)
        return None if data is None else decode(data, Receipts).receipts

    def block_bytes(self, height: int) -> bytes | None:
        return self._snapshot.block(height)

    def receipt_bytes(self, height: int) -> Sequence[tuple[bytes, bytes]] | None:
        """Raises STORAGE_DAMAGED."""
        data = self._snapshot.receipts(height)
        if data is None:
            return None
        try:
            return [(_read_receipt_shape(raw).txid, bytes(raw)) for raw in _read_receipts_shape(data).receipts]
        except msgspec.MsgspecError:
            raise BlockRobotError("STORAGE_DAMAGED", f"The receipts of the ledger's block {height} are none.") from None

    def receipt(self, height: int, index: int) -> Receipt | None:
        data = self._snapshot.receipts(height)
        return None if data is None else decode(bytes(_read_receipts_shape(data).receipts[index]), Receipt)

    def events(self, height: int, index: int, limit: int) -> Sequence[tuple[int, int, ContractEvent]]:
        found = self._snapshot.events(EventCursor(height, index), limit)
        return [(place.height, place.index, decode(data, ContractEvent)) for place, data in found]

    def header_bytes(self, height: int) -> bytes | None:
        head = self.head(height)
        return None if head is None else head.header_bytes

    def head(self, height: int) -> BlockHead | None:
        """Raises STORAGE_DAMAGED."""
        block = self._snapshot.block(height)
        if block is None:
            kept = self._snapshot.kept_header(height)
            return None if kept is None else BlockHead(kept, None)
        try:
            shape = _read_shape(block)
        except msgspec.MsgspecError:
            raise BlockRobotError("STORAGE_DAMAGED", f"The ledger's block {height} is none.") from None
        return BlockHead(shape.header_bytes, len(shape.transactions))

    def block_height(self, block_id: bytes) -> int | None:
        return self._snapshot.block_height(block_id)

    @property
    def earliest_height(self) -> int:
        return self._snapshot.earliest_height

    def epoch_proof(self, number: int) -> bytes | None:
        return self._snapshot.epoch_proof(number)

    def locate(self, txid: bytes) -> TransactionPlace | None:
        found = self._snapshot.locate(txid)
        return None if found is None else TransactionPlace(height=found.height, index=found.index)


class EngineRounds:
    """`RoundWatch` over the engine; also a finality listener. Event loop only."""

    def __init__(self, engine: Engine, clock: Clock) -> None:
        self._engine = engine
        self._clock = clock
        self._lags_ms: OrderedDict[int, int] = OrderedDict()

    def note_final(self, blocks: Sequence[ExecutedBlock], _proof: FinalityProof, _position: Position) -> None:
        now_ms = self._clock.now_ms()
        for block in blocks:
            self._lags_ms[block.header.height] = now_ms - block.header.timestamp_ms
        while len(self._lags_ms) > LAGS_KEPT_COUNT:
            self._lags_ms.popitem(last=False)

    def finality_lag_ms(self, height: int) -> int | None:
        return self._lags_ms.get(height)

    def place(self) -> RoundDocument:
        core = self._engine.core
        return RoundDocument(
            epoch=core.epoch,
            round=core.round,
            leader=core.leader,
            certified_height=core.finalized.height + len(core.certified_branch()),
            timed_out_count=self._engine.rounds_timed_out_count,
        )


class FinalizedLedger:
    """`LedgerReader` over the node's store."""

    def __init__(self, ledger: LedgerStore, feed: FinalityFeed) -> None:
        self._ledger = ledger
        self._feed = feed

    @contextmanager
    def snapshot(self) -> Iterator[DecodedSnapshot]:
        with self._ledger.snapshot() as snapshot:
            yield DecodedSnapshot(snapshot)

    async def wait_above(self, height: int, timeout_ms: int) -> bool:
        return await self._feed.wait_above(height, timeout_ms)


class Pool:
    """`TransactionPool` over the mempool: admits, gossips, wakes the engine."""

    def __init__(
        self,
        *,
        mempool: Mempool,
        intake: TransactionIntake,
        engine: Engine,
        gossip: Gossip,
        feed: FinalityFeed,
        clock: Clock,
        calls: CallCheck,
    ) -> None:
        """`calls` checks client submissions only, not what peers pass on."""
        self._mempool = mempool
        self._intake = intake
        self._engine = engine
        self._gossip = gossip
        self._feed = feed
        self._clock = clock
        self._calls = calls
        self._expired: OrderedDict[bytes, None] = OrderedDict()

    async def submit(self, wires: Sequence[bytes], source: Source = OWN) -> Sequence[SubmitResult]:
        """Raises RATE_LIMITED."""
        found: dict[bytes, SubmitResult] = {}

        def note(outcomes: list[Outcome]) -> None:
            for outcome in outcomes:
                txid = b"" if outcome.transaction is None else outcome.transaction.txid
                found[outcome.wire] = SubmitResult(txid=txid, error=outcome.error)
            fresh = [item.transaction for item in outcomes if item.is_new and item.transaction is not None]
            if fresh:
                self._gossip.offer(fresh)
                self._engine.note_work()

        await self._intake.submit(source, list(dict.fromkeys(wires)), self._calls.require, note)
        return [found[wire] for wire in wires]

    def status(self, txid: bytes) -> PoolStatus:
        if txid in self._mempool or self._engine.is_on_branch(txid):
            return "pending"
        return "expired" if txid in self._expired else "unknown"

    async def wait_final(self, txid: bytes, timeout_ms: int) -> bool:
        return await self._feed.wait_final(txid, timeout_ms)

    def purge_expired(self) -> int:
        expired = self._mempool.purge_expired(self._clock.now_ms())
        for txid in expired:
            self._expired[txid] = None
        while len(self._expired) > EXPIRED_REMEMBERED_MAX_COUNT:
            self._expired.popitem(last=False)
        self._feed.give_up(expired)
        return len(expired)

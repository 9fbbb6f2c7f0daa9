"""Ledgers of any size without a network: filled by the restore of snapshots, with blocks that a client takes for final."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path

from msgspec import structs

from consensus.chain.block import (
    HEADER_VERSION,
    Block,
    ContractEvent,
    FinalityProof,
    Header,
    IndexedSignature,
    QuorumCertificate,
    Receipt,
    Receipts,
    compute_receipts_root,
    compute_transactions_root,
    genesis_certificate,
)
from consensus.chain.messages import sign_block, sign_vote
from consensus.chain.transaction import Transaction
from consensus.primitives.encoding import decode, encode, u64
from consensus.primitives.hashing import sha256
from contracts.execution.genesis import open_genesis
from network.sim.plan import NetworkSize
from network.sim.world.sim_chain import Chain, make_chain
from node.execution.execution_machines import BlockExecutionResult
from node.storage.ledger_store import FinalizedBlock, LedgerStore
from node.storage.lmdb_restore import LmdbRestore
from node.storage.lmdb_store import LmdbStore

Rows = Iterable[tuple[bytes, bytes]]
OnProgress = Callable[[str], None]

LEDGER = "ledger"
BLOCK_INTERVAL_MS = 1_000
_ROWS_AT_ONCE_COUNT = 50_000
_BLOCKS_AT_ONCE_COUNT = 2_000
_CALL_BYTES = 700


def open_chain() -> Chain:
    """Of one producer, whose vote makes a block final."""
    return make_chain(NetworkSize(1, 1))


def _certify(chain: Chain, header: Header) -> QuorumCertificate:
    block_id, genesis = sha256(encode(header)), chain.genesis
    vote = sign_vote(chain.producers[0], genesis.chain_id, 0, header.round, block_id, 0)
    votes = (IndexedSignature(index=0, signature=vote.signature),)
    return QuorumCertificate(epoch=0, round=header.round, block_id=block_id, votes=votes)


class BlockMaker:
    """Makes the blocks behind a header; `finality` proves the newest one. None is from before `at_ms`."""

    def __init__(self, chain: Chain, parent: Header) -> None:
        self.chain, self.parent, self.at_ms = chain, parent, 0

    @classmethod
    def behind(cls, chain: Chain, ledger: LedgerStore) -> BlockMaker:
        with ledger.snapshot() as snapshot:
            data = None if snapshot.position is None else snapshot.block(snapshot.position.height)
        return cls(chain, chain.genesis.block().header if data is None else decode(data, Block).header)

    @property
    def next_ms(self) -> int:
        """The time of the block that comes next."""
        return max(self.parent.timestamp_ms + BLOCK_INTERVAL_MS, self.at_ms)

    def _header(self, parent: Header, qc: QuorumCertificate, result: BlockExecutionResult | None = None) -> Header:
        receipts = () if result is None else result.receipts
        return Header(
            version=HEADER_VERSION,
            chain_id=self.chain.genesis.chain_id,
            epoch=0,
            height=parent.height + 1,
            round=parent.round + 1,
            parent_id=sha256(encode(parent)),
            qc=qc,
            tc=None,
            producer=0,
            timestamp_ms=max(parent.timestamp_ms + BLOCK_INTERVAL_MS, self.at_ms),
            transactions_root=compute_transactions_root([receipt.txid for receipt in receipts]),
            receipts_root=compute_receipts_root(receipts),
            state_root=parent.state_root if result is None else result.state_root,
            next_schedule_hash=None,
            gas_used=0 if result is None else result.gas_used,
        )

    def _parent_certificate(self) -> QuorumCertificate:
        if self.parent.height == 0:
            return genesis_certificate(self.chain.genesis.block_id)
        return _certify(self.chain, self.parent)

    def _stored(
        self, header: Header, wires: tuple[bytes, ...], receipts: tuple[Receipt, ...], signature: bytes = bytes(64)
    ) -> FinalizedBlock:
        data = encode(header)
        self.parent = header
        until_ms = header.timestamp_ms + BLOCK_INTERVAL_MS
        return FinalizedBlock(
            height=header.height,
            block_id=sha256(data),
            block_bytes=encode(Block(header_bytes=data, signature=signature, transactions=wires)),
            receipts_bytes=encode(Receipts(receipts=receipts)),
            timestamp_ms=header.timestamp_ms,
            state_root=header.state_root,
            transactions=[(receipt.txid, until_ms) for receipt in receipts],
            events=[encode(event) for receipt in receipts for event in receipt.events],
        )

    def at_root(self, state_root: bytes) -> FinalizedBlock:
        """The block that says this state."""
        header = self._header(self.parent, self._parent_certificate())
        return self._stored(structs.replace(header, state_root=state_root), (), ())

    def of_result(self, result: BlockExecutionResult, calls: Iterable[Transaction]) -> FinalizedBlock:
        header = self._header(self.parent, self._parent_certificate(), result)
        wires = tuple(call.wire for call in calls)
        signature = sign_block(
            self.chain.producers[0], header.chain_id, header.epoch, header.round, sha256(encode(header))
        )
        block = self._stored(header, wires, result.receipts, signature)
        return replace(block, state_writes=result.writes, page_writes=result.page_writes)

    def filler(self) -> FinalizedBlock:
        """With one call of common size; its certificate is of the right form only."""
        votes = (IndexedSignature(index=0, signature=bytes(64)),)
        qc = QuorumCertificate(epoch=0, round=self.parent.round, block_id=bytes(32), votes=votes)
        txid = call_id(self.parent.height + 1)
        event = ContractEvent(contract="records", name="recorded", data=txid * 8)
        receipt = Receipt(txid=txid, ok=True, code="OK", message="", line=None, gas_used=1, events=(event,))
        return self._stored(self._header(self.parent, qc), (txid * (_CALL_BYTES // len(txid)),), (receipt,))

    def finality(self) -> bytes:
        qc = _certify(self.chain, self.parent)
        child = self._header(self.parent, qc)
        proof = FinalityProof(
            header_bytes=encode(self.parent), child_header_bytes=encode(child), child_qc=_certify(self.chain, child)
        )
        return encode(proof)


def call_id(height: int) -> bytes:
    """Of the one call of a filler block."""
    return sha256(b"call" + u64(height))


async def fill_ledger(folder: Path, rows: Rows, blocks: int, on_progress: OnProgress) -> None:
    """Make a ledger of genesis, `rows` (in key order) and a chain of `blocks`."""
    chain = open_chain()
    own = sorted(open_genesis(chain.genesis).writes.items())
    restore = LmdbRestore(folder / LEDGER)
    done = 0
    for batch in _batches(heapq.merge(own, rows), _ROWS_AT_ONCE_COUNT):
        restore.put_state(batch)
        done += len(batch)
        on_progress(f"filling: {done} rows of the state")
    maker = BlockMaker(chain, chain.genesis.block().header)
    head = maker.at_root(restore.state_root)
    restore.finish(chain.genesis.block_id, head, maker.finality(), ())
    store = LmdbStore.open(folder / LEDGER)
    try:
        for first in range(0, blocks, _BLOCKS_AT_ONCE_COUNT):
            on_progress(f"filling: {first} of {blocks} blocks")
            fillers = [maker.filler() for _ in range(min(_BLOCKS_AT_ONCE_COUNT, blocks - first))]
            await store.commit(fillers, maker.finality())
    finally:
        await store.close()


def _batches(rows: Rows, count: int) -> Iterator[list[tuple[bytes, bytes]]]:
    left = iter(rows)
    while batch := list(islice(left, count)):
        yield batch

"""A chain made by hand whose blocks hold transactions and write state: for tests of stores, snapshots and comparisons."""

from __future__ import annotations

import random
from collections.abc import Mapping, Sequence

import msgspec

from consensus.chain.block import (
    HEADER_VERSION,
    Block,
    ContractEvent,
    EpochProof,
    FinalityProof,
    Header,
    QuorumCertificate,
    Receipt,
    Receipts,
    compute_receipts_root,
    compute_transactions_root,
    genesis_certificate,
)
from consensus.chain.epoch_settings import Epoch, compute_epoch_hash
from consensus.chain.genesis import Genesis
from consensus.chain.messages import sign_block
from consensus.chain.schedule import Schedule
from consensus.chain.transaction import Transaction, sign_transaction
from consensus.primitives.encoding import decode_value, encode, encode_value
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.state.producers import EPOCH
from contracts.execution.results import BlockResult
from contracts.state.trie import apply_batch
from contracts.state.view import MemoryState, StateView
from node.storage.ledger_store import FinalizedBlock, LedgerStore
from tests.unit.node.hand_made_chain import KEYS, START_MS, IndexedSignature, make_genesis, sign_vote

SENDER = PrivateKey(sha256(b"sender"))


class WritingMachine:
    """Executes transactions that say themselves what they write: their arguments are pairs of key and value."""

    def build(
        self, parent: StateView, height: int, time_ms: int, transactions: Sequence[Transaction], **_: object
    ) -> tuple[BlockResult, list[bytes]]:
        return self.verify(parent, height, time_ms, transactions), []

    def verify(
        self, parent: StateView, height: int, time_ms: int, transactions: Sequence[Transaction], **_: object
    ) -> BlockResult:
        writes: dict[bytes, bytes | None] = {}
        for item in transactions:
            writes |= dict(decode_value(item.body.args))
        update = apply_batch(parent, parent.state_root, writes)
        receipts = receipts_of(transactions)
        return BlockResult(
            receipts=receipts.receipts,
            writes=writes,
            page_writes=update.pages,
            state_root=update.root,
            receipt_root=compute_receipts_root(receipts.receipts),
            gas_used=10 * len(transactions),
            left_out=(),
        )


def _epoch_value(epoch: Epoch, height: int) -> bytes:
    """What the contracts write when an epoch is decided."""
    return encode_value(
        {
            "number": epoch.number,
            "producers": list(epoch.producers),
            "leaderless": list(epoch.leaderless),
            "settings": msgspec.structs.asdict(epoch.settings),
            "height": height,
        }
    )


def receipts_of(transactions: Sequence[Transaction]) -> Receipts:
    event = ContractEvent("records", "recorded", encode_value({}))
    return Receipts(tuple(Receipt(item.txid, True, "OK", "", None, 10, (event,)) for item in transactions))


class WrittenChain:
    """Makes consecutive blocks of the four producers of `hand_made_chain`; `state` is that after the newest."""

    def __init__(self, genesis: Genesis | None = None, seed: int = 7) -> None:
        self.genesis = make_genesis() if genesis is None else genesis
        self.state = MemoryState()
        self.schedule: Schedule = self.genesis.schedule
        self.random = random.Random(seed)
        first = self.genesis.block()
        self.blocks: list[Block] = [first]
        self.stored: list[FinalizedBlock] = [
            FinalizedBlock(0, first.block_id, encode(first), encode(Receipts(())), START_MS, self.genesis.state_root)
        ]
        self.epoch_proofs: list[bytes] = []
        self._qc = genesis_certificate(self.genesis.block_id)

    def transaction(self, timestamp_ms: int, writes: Sequence[tuple[bytes, bytes | None]] = ()) -> Transaction:
        return sign_transaction(
            SENDER,
            chain_id=self.genesis.chain_id,
            contract="records",
            entry="record",
            arguments=[[key, value] for key, value in writes],
            valid_until_ms=timestamp_ms + 60_000,
            salt=self.random.randbytes(8),
        )

    def extend(
        self,
        writes: Mapping[bytes, bytes | None] | None = None,
        *,
        transactions: int = 1,
        later_ms: int = 1000,
        next_epoch: Epoch | None = None,
    ) -> FinalizedBlock:
        """Make the next block: what it writes (a few keys unless said) and how many transactions it holds."""
        if writes is None:
            writes = {b"records\x00%d" % self.random.randrange(400): self.random.randbytes(20) for _ in range(10)}
            writes[b"records\x00%d" % self.random.randrange(400)] = None
        if next_epoch is not None:
            writes = {**writes, EPOCH.flat: _epoch_value(next_epoch, len(self.blocks))}
        parent = self.blocks[-1].header
        timestamp_ms = parent.timestamp_ms + later_ms
        shares = [list(writes.items())[index::transactions] for index in range(transactions)]
        held = [self.transaction(timestamp_ms, share) for share in shares]
        receipts = receipts_of(held)
        update = self.state.apply(writes)
        block = self._sign(timestamp_ms, held, receipts, update.root, next_epoch)
        self.blocks.append(block)
        proof = b""
        if next_epoch is not None:
            proof = encode(EpochProof(self.proof(), next_epoch))
            self.epoch_proofs.append(proof)
            self.schedule = Schedule.of(next_epoch)
            self._qc = genesis_certificate(block.block_id, next_epoch.number)
        else:
            self._qc = self.certify(block)
        stored = FinalizedBlock(
            height=block.header.height,
            block_id=block.block_id,
            block_bytes=encode(block),
            receipts_bytes=encode(receipts),
            timestamp_ms=timestamp_ms,
            state_root=update.root,
            transactions=[(item.txid, item.body.valid_until_ms) for item in held],
            state_writes=dict(writes),
            page_writes=update.pages,
            events=[encode(event) for receipt in receipts.receipts for event in receipt.events],
            epoch_proof_bytes=proof,
        )
        self.stored.append(stored)
        return stored

    def _sign(
        self,
        timestamp_ms: int,
        transactions: Sequence[Transaction],
        receipts: Receipts,
        state_root: bytes,
        next_epoch: Epoch | None,
    ) -> Block:
        parent, round_number, epoch = self.blocks[-1], self._qc.round + 1, self.schedule.epoch
        producer = self.schedule.leader(round_number)
        header = Header(
            version=HEADER_VERSION,
            chain_id=self.genesis.chain_id,
            epoch=epoch,
            height=parent.header.height + 1,
            round=round_number,
            parent_id=parent.block_id,
            qc=self._qc,
            tc=None,
            producer=producer,
            timestamp_ms=timestamp_ms,
            transactions_root=compute_transactions_root([item.txid for item in transactions]),
            receipts_root=compute_receipts_root(receipts.receipts),
            state_root=state_root,
            next_schedule_hash=None if next_epoch is None else compute_epoch_hash(next_epoch),
            gas_used=10 * len(transactions),
        )
        data = encode(header)
        signature = sign_block(self._key(producer), self.genesis.chain_id, epoch, round_number, sha256(data))
        return Block(data, signature, tuple(item.wire for item in transactions))

    def _key(self, index: int) -> PrivateKey:
        return next(key for key in KEYS if key.public_key == self.schedule.producers[index])

    def certify(self, block: Block) -> QuorumCertificate:
        """A certificate by the first quorum of the epoch's producers."""
        header = block.header
        signers = range(self.schedule.quorum)
        votes = [
            sign_vote(self._key(index), self.genesis.chain_id, header.epoch, header.round, block.block_id, index)
            for index in signers
        ]
        signatures = tuple(IndexedSignature(vote.index, vote.signature) for vote in votes)
        return QuorumCertificate(header.epoch, header.round, block.block_id, signatures)

    def proof(self) -> FinalityProof:
        """The proof that the newest block is final: an empty child that is not part of the chain."""
        newest = self.blocks[-1]
        header = newest.header
        child = msgspec.structs.replace(
            header,
            height=header.height + 1,
            round=header.round + 1,
            parent_id=newest.block_id,
            qc=self.certify(newest),
            producer=self.schedule.leader(header.round + 1),
            timestamp_ms=header.timestamp_ms + 1,
            next_schedule_hash=None,
            is_closing=header.next_schedule_hash is not None,
            transactions_root=compute_transactions_root([]),
            receipts_root=compute_receipts_root(()),
            gas_used=0,
        )
        data = encode(child)
        return FinalityProof(newest.header_bytes, data, self.certify(Block(data, b"", ())))

    async def fill(self, store: LedgerStore) -> None:
        """Store all that the store lacks, with the proof of the newest."""
        first = 0 if store.position is None else store.position.height + 1
        finality = encode(self.proof()) if len(self.blocks) > 1 else b""
        await store.commit(self.stored[first:], finality)

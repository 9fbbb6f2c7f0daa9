"""Checks a snapshot from genesis on, and loads it into a new ledger.

Verified: chunk hashes, finality along the epochs, replay window, state root.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from consensus.chain.block import (
    Block,
    EpochProof,
    FinalityProof,
    Header,
    Receipts,
    compute_receipts_root,
    compute_transactions_root,
)
from consensus.chain.genesis import Genesis
from consensus.chain.light_client import LightClient
from consensus.chain.messages import is_valid_block_signature
from consensus.chain.schedule import Schedule
from consensus.chain.transaction import decode_transaction
from consensus.errors import BlockRobotError
from consensus.limits import TRANSACTION_LIFETIME_MAX_MS
from consensus.primitives.encoding import decode, encode
from consensus.primitives.hashing import sha256
from node.snapshot.making import Progress, no_progress
from node.snapshot.snapshot_format import Manifest, RecentChunk, RecentRow, SnapshotSource, StateChunk, read_manifest
from node.storage.ledger_store import FinalizedBlock, KeptBlock, LedgerRestore, RecentBlock

PUT_AT_ONCE_COUNT = 20_000


@dataclass(frozen=True, slots=True)
class ProvenHead:
    """The block of a snapshot, proven final."""

    manifest: Manifest
    block: Block
    header: Header
    receipts: Receipts
    transactions: tuple[tuple[bytes, int], ...]

    def to_stored(self) -> FinalizedBlock:
        return FinalizedBlock(
            height=self.header.height,
            block_id=self.block.block_id,
            block_bytes=self.manifest.block,
            receipts_bytes=self.manifest.receipts,
            timestamp_ms=self.header.timestamp_ms,
            state_root=self.header.state_root,
            transactions=self.transactions,
            events=[encode(event) for receipt in self.receipts.receipts for event in receipt.events],
        )


def _damaged(detail: str) -> BlockRobotError:
    return BlockRobotError("SNAPSHOT_DAMAGED", detail)


def verify_head(manifest: Manifest, genesis: Genesis) -> ProvenHead:
    """Return the manifest's block, proven final from genesis.

    Raises SNAPSHOT_OTHER_CHAIN, SNAPSHOT_UNPROVEN, SNAPSHOT_DAMAGED.
    """
    if manifest.chain_id != genesis.chain_id:
        raise BlockRobotError("SNAPSHOT_OTHER_CHAIN")
    try:
        block, receipts = decode(manifest.block, Block), decode(manifest.receipts, Receipts)
        header = block.header
        transactions = [decode_transaction(wire) for wire in block.transactions]
        if header.height == 0:
            if block != genesis.block():
                raise _unproven("The snapshot's genesis block is not this chain's.")
            if manifest.epoch_proofs or manifest.finality:
                raise _unproven("Nothing follows genesis yet, and nothing has to prove it.")
        else:
            _verify_finality(manifest, genesis, block)
    except BlockRobotError as error:
        if error.code.startswith("SNAPSHOT_"):
            raise
        raise _unproven(f"The snapshot proves nothing: {error.detail}") from error
    if header.height != manifest.height:
        raise _damaged("The manifest names another height than its block.")
    if compute_transactions_root([item.txid for item in transactions]) != header.transactions_root:
        raise _damaged("The snapshot's block does not hold the transactions that its header names.")
    if compute_receipts_root(receipts.receipts) != header.receipts_root:
        raise _damaged("The snapshot's receipts are not those that the header names.")
    expiries = tuple((item.txid, item.body.valid_until_ms) for item in transactions)
    return ProvenHead(manifest, block, header, receipts, expiries)


def _unproven(detail: str) -> BlockRobotError:
    return BlockRobotError("SNAPSHOT_UNPROVEN", detail)


def _verify_finality(manifest: Manifest, genesis: Genesis, block: Block) -> None:
    """Follow every epoch proof once, in order; the ledger trusts them afterwards."""
    header = block.header
    proofs = [decode(data, EpochProof) for data in manifest.epoch_proofs]
    if [proof.epoch.number for proof in proofs] != list(range(1, header.epoch + header.is_boundary + 1)):
        raise _unproven("The snapshot's epoch proofs are not those of the epochs up to its block, one by one.")
    client = LightClient(genesis)
    for proof in proofs[: header.epoch]:
        client.advance(proof)
    client.accept(decode(manifest.finality, FinalityProof))
    _verify_producer(genesis.chain_id, Schedule.of(client.epoch), block)
    for proof in proofs[header.epoch :]:
        client.advance(proof)
    if client.pinned_header_bytes != block.header_bytes:
        raise _unproven("The proof is for another block than the snapshot's.")
    if client.epoch.number != len(proofs):
        raise _unproven("The snapshot's epoch proofs do not lead into the epoch that follows its block.")


def _verify_producer(chain_id: bytes, schedule: Schedule, block: Block) -> None:
    header = block.header
    if not 0 <= header.producer < len(schedule.producers) or not is_valid_block_signature(
        chain_id, header.epoch, header.round, block.block_id, block.signature, schedule.producers[header.producer]
    ):
        raise _damaged("The snapshot's block is not signed by its producer.")


def _checked_chunk(source: _Sized, manifest: Manifest, index: int) -> bytes:
    data = source.chunk(index)
    if sha256(data) != manifest.chunks[index]:
        raise _damaged(f"Chunk {index} does not have the hash that the manifest names.")
    return data


def require_whole(source: SnapshotSource, manifest: Manifest, progress: Progress = no_progress) -> None:
    """Check every chunk's hash. Raises SNAPSHOT_DAMAGED, SNAPSHOT_TRUNCATED, FILE_UNUSABLE."""
    sized = _Sized(source)
    for index in range(len(manifest.chunks)):
        _checked_chunk(sized, manifest, index)
        progress(index + 1, sized.size_bytes)


class _Window:
    def __init__(self, head: ProvenHead) -> None:
        self._head = head
        self._previous: Header | None = None
        self._previous_id = b""
        self.count = 0

    def take(self, row: RecentRow) -> KeptBlock:
        """Raises SNAPSHOT_DAMAGED."""
        header, block_id = decode(row.header_bytes, Header), sha256(row.header_bytes)
        if self._previous is None:
            self._check_reach(header)
        elif header.parent_id != self._previous_id or header.height != self._previous.height + 1:
            raise _damaged("The blocks of the replay window do not follow one another.")
        if compute_transactions_root([txid for txid, _ in row.transactions]) != header.transactions_root:
            raise _damaged(f"The replay window does not hold the transactions of block {header.height}.")
        latest_ms = header.timestamp_ms + TRANSACTION_LIFETIME_MAX_MS
        if any(not header.timestamp_ms < valid_until_ms <= latest_ms for _, valid_until_ms in row.transactions):
            raise _damaged("The replay window names an expiry that no block would have accepted.")
        self._previous, self._previous_id = header, block_id
        self.count += 1
        recent = RecentBlock(header.height, header.timestamp_ms, row.transactions)
        return KeptBlock(recent, block_id, row.header_bytes)

    def _check_reach(self, oldest: Header) -> None:
        window_ms = self._head.header.timestamp_ms - TRANSACTION_LIFETIME_MAX_MS
        if oldest.height > 0 and oldest.timestamp_ms > window_ms:
            raise _damaged("The replay window does not reach back ten minutes.")

    def close(self) -> None:
        if self._previous_id != self._head.block.block_id:
            raise _damaged("The replay window does not lead up to the snapshot's block.")
        if self.count != self._head.manifest.recent_block_count:
            raise _damaged("The replay window has another number of blocks than the manifest says.")


class _Sized:
    def __init__(self, source: SnapshotSource) -> None:
        self._source = source
        self.size_bytes = 0

    def chunk(self, index: int) -> bytes:
        data = self._source.chunk(index)
        self.size_bytes += len(data)
        return data


def _recent_blocks(source: _Sized, head: ProvenHead, progress: Progress) -> Iterator[KeptBlock]:
    window = _Window(head)
    for index in range(head.manifest.recent_chunk_count):
        data = _checked_chunk(source, head.manifest, index)
        for row in decode(data, RecentChunk).blocks:
            kept = window.take(row)
            if kept.block_id != head.block.block_id:
                yield kept
        progress(index + 1, source.size_bytes)
    window.close()


def restore_into(
    source: SnapshotSource, genesis: Genesis, ledger: LedgerRestore, progress: Progress = no_progress
) -> ProvenHead:
    """Check a snapshot and load it; the ledger exists only if all is valid.

    Raises SNAPSHOT_VERSION, SNAPSHOT_DAMAGED, SNAPSHOT_TRUNCATED, SNAPSHOT_OTHER_CHAIN, SNAPSHOT_UNPROVEN, STORAGE_*.
    """
    try:
        head = verify_head(read_manifest(source.manifest()), genesis)
        _feed(source, head, ledger, progress)
        ledger.finish(genesis.block_id, head.to_stored(), head.manifest.finality, head.manifest.epoch_proofs)
    except BlockRobotError as error:
        ledger.abandon()
        if error.code.startswith("ENCODING_"):
            raise _damaged(f"A part of the snapshot cannot be read: {error.detail}") from error
        raise
    except BaseException:
        ledger.abandon()
        raise
    return head


def _feed(source: SnapshotSource, head: ProvenHead, ledger: LedgerRestore, progress: Progress) -> None:
    manifest = head.manifest
    kept: list[KeptBlock] = []
    sized = _Sized(source)
    for block in _recent_blocks(sized, head, progress):
        kept.append(block)
        if len(kept) >= PUT_AT_ONCE_COUNT:
            ledger.put_kept(kept)
            kept = []
    ledger.put_kept(kept)
    rows: list[tuple[bytes, bytes]] = []
    count = 0
    for index in range(manifest.recent_chunk_count, len(manifest.chunks)):
        chunk = decode(_checked_chunk(sized, manifest, index), StateChunk)
        rows += chunk.rows
        count += len(chunk.rows)
        if len(rows) >= PUT_AT_ONCE_COUNT:
            ledger.put_state(rows)
            rows = []
        progress(index + 1, sized.size_bytes)
    ledger.put_state(rows)
    if (count, sized.size_bytes) != (manifest.state_row_count, manifest.size_bytes):
        raise _damaged("The state has another number of rows or bytes than the manifest says.")

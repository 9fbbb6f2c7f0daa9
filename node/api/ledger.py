"""The finalized ledger for the HTTP interface, on the node's store. Must never answer from anything but the store.

What a client is told is in the synced store already, so it survives a power cut of the whole cluster.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property

from consensus.block import Block, FinalityProof, Header, Receipt, Receipts
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode
from consensus.primitives.trie import Proof
from node.api.services import TransactionPlace
from node.finality import FinalityFeed
from node.storage.ledger_store import LedgerSnapshot as StoreSnapshot
from node.storage.ledger_store import LedgerStore


class StoredSnapshot:
    """One position of the store, read as the interface needs it (`node.api.services.LedgerSnapshot`)."""

    def __init__(self, snapshot: StoreSnapshot) -> None:
        self._snapshot = snapshot
        position = snapshot.position
        if position is None:
            raise BlockRobotError("NODE_NOT_READY", "The node's ledger does not hold genesis yet.")
        self._height = position.height

    @cached_property
    def header(self) -> Header:
        """The header of the newest finalized block."""
        block = self.block(self._height)
        if block is None:
            raise BlockRobotError("STORAGE_DAMAGED", "The newest block is not in the store.")
        return block.header

    @cached_property
    def finality(self) -> FinalityProof | None:
        """The proof that `header` is final; None at genesis."""
        return None if self._height == 0 else decode(self._snapshot.finality, FinalityProof)

    def get(self, key: bytes) -> bytes | None:
        """Return the encoded value under a flat key, or None."""
        return self._snapshot.get(key)

    def scan(self, prefix: bytes, limit: int) -> Iterator[tuple[bytes, bytes]]:
        """Yield up to `limit` pairs of flat key and encoded value under the prefix, in key order."""
        return self._snapshot.scan(prefix, limit)

    def prove(self, key: bytes) -> Proof:
        """Return the proof of the key's presence or absence under `header.state_root`."""
        return self._snapshot.prove(key)

    def block(self, height: int) -> Block | None:
        """Return the finalized block of this height, or None."""
        data = self._snapshot.block(height)
        return None if data is None else decode(data, Block)

    def receipts(self, height: int) -> Sequence[Receipt] | None:
        """Return the receipts of the block of this height, or None."""
        data = self._snapshot.receipts(height)
        return None if data is None else decode(data, Receipts).receipts

    def locate(self, txid: bytes) -> TransactionPlace | None:
        """Return where a finalized transaction stands, or None."""
        place = self._snapshot.locate(txid)
        return None if place is None else TransactionPlace(place.height, place.index)


class StoredLedger:
    """The store and who waits for it (`node.api.services.LedgerReader`)."""

    def __init__(self, store: LedgerStore, feed: FinalityFeed) -> None:
        self._store = store
        self._feed = feed

    @contextmanager
    def snapshot(self) -> Iterator[StoredSnapshot]:
        """Open a snapshot of the newest finalized block. Raises STORAGE_BUSY, NODE_NOT_READY."""
        with self._store.snapshot() as snapshot:
            yield StoredSnapshot(snapshot)

    async def wait_above(self, height: int, timeout_ms: int) -> bool:
        """Wait until a block above `height` is stored; tell whether one is, or the time ran out."""
        return await self._feed.wait_above(height, timeout_ms)

"""What is read of the ledger at one finalized block, decoded."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

from consensus.chain.block import Block, ContractEvent, FinalityProof, Header, Receipt
from consensus.errors import BlockRobotError
from consensus.primitives.trie import Proof

PeersWithBlock = Callable[[int], Sequence[str]]
"""Returns the names of the peers that say they keep the body of the block of a height."""


@dataclass(frozen=True, slots=True)
class TransactionPlace:
    """A finalized transaction's block height and index."""

    height: int
    index: int


@dataclass(frozen=True, slots=True)
class BlockHead:
    """A header's bytes and transaction count (None once pruned)."""

    header_bytes: bytes
    transactions_count: int | None


class LedgerView(Protocol):
    """The ledger at one finalized block; immutable while open."""

    @property
    def header(self) -> Header: ...

    @property
    def finality(self) -> FinalityProof | None:
        """Return the proof that `header` is final; None only at genesis."""
        ...

    def get(self, key: bytes) -> bytes | None: ...

    def scan(self, prefix: bytes, limit: int) -> Iterator[tuple[bytes, bytes]]:
        """Yield up to `limit` pairs (flat key, encoded value), in key order."""
        ...

    def scan_range(self, start: bytes, end: bytes) -> Iterator[tuple[bytes, bytes]]:
        """Yield pairs from `start` up to but without `end`, in key order."""
        ...

    def prove(self, key: bytes) -> Proof: ...

    def block(self, height: int) -> Block | None:
        """Return a finalized block; None above the head or if pruned."""
        ...

    def receipts(self, height: int) -> Sequence[Receipt] | None: ...

    def block_bytes(self, height: int) -> bytes | None: ...

    def receipt_bytes(self, height: int) -> Sequence[tuple[bytes, bytes]] | None:
        """Return txid and canonical bytes of a block's receipts, or None."""
        ...

    def receipt(self, height: int, index: int) -> Receipt | None: ...

    def events(self, height: int, index: int, limit: int) -> Sequence[tuple[int, int, ContractEvent]]: ...

    def header_bytes(self, height: int) -> bytes | None:
        """Return a finalized header's bytes, pruned or not, or None."""
        ...

    def head(self, height: int) -> BlockHead | None: ...

    def block_height(self, block_id: bytes) -> int | None: ...

    @property
    def earliest_height(self) -> int:
        """Return the lowest height whose body is kept (0: unpruned)."""
        ...

    def epoch_proof(self, number: int) -> bytes | None:
        """Return the encoded `EpochProof` that began epoch `number` (1 or above)."""
        ...

    def locate(self, txid: bytes) -> TransactionPlace | None: ...


def require_not_pruned(snapshot: LedgerView, height: int, peers_with_block: PeersWithBlock) -> None:
    """Raise BLOCK_PRUNED, naming keepers, if this block's body is not here."""
    earliest = snapshot.earliest_height
    if height < earliest:
        names = peers_with_block(height)
        who = f"{', '.join(names)} {'keep' if len(names) > 1 else 'keeps'} it" if names else "No peer says to keep it"
        raise BlockRobotError(
            "BLOCK_PRUNED", f"The body of block {height} was pruned; this node has them from {earliest} on. {who}."
        )

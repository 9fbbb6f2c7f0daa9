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
        """See `LedgerSnapshot.scan`."""
        ...

    def scan_range(self, start: bytes, end: bytes) -> Iterator[tuple[bytes, bytes]]:
        """See `LedgerSnapshot.scan_range`."""
        ...

    def prove(self, key: bytes) -> Proof: ...

    def block(self, height: int) -> Block | None:
        """None above the head or if pruned."""
        ...

    def receipts(self, height: int) -> Sequence[Receipt] | None: ...

    def block_bytes(self, height: int) -> bytes | None: ...

    def receipt_bytes(self, height: int) -> Sequence[tuple[bytes, bytes]] | None:
        """Txid and canonical bytes of each."""
        ...

    def receipt(self, height: int, index: int) -> Receipt | None: ...

    def events(self, height: int, index: int, limit: int) -> Sequence[tuple[int, int, ContractEvent]]: ...

    def header_bytes(self, height: int) -> bytes | None:
        """Pruned or not."""
        ...

    def head(self, height: int) -> BlockHead | None: ...

    def block_height(self, block_id: bytes) -> int | None: ...

    @property
    def earliest_height(self) -> int:
        """0 if unpruned."""
        ...

    def epoch_proof(self, number: int) -> bytes | None:
        """Encoded; from epoch 1 on."""
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

"""What a custodian hears of a finalized block: events of four contracts, and who is a custodian no more.

Must never tell of a block that is not final.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from consensus.chain.block import Receipt
from consensus.primitives.encoding import decode_value
from node.custody.stores.custody_store import Checkpoint

CUSTODY_CONTRACTS = frozenset({"records", "access", "erasure", "rights"})
CUSTODIANS_REMOVED = "identity.custodians_removed"


@dataclass(frozen=True, slots=True)
class FinalizedEvent:
    """One event: the transaction that caused it, contract, name, and its data as a decoded dict."""

    txid: bytes
    contract: str
    name: str
    data: dict[str, Any]

    @property
    def kind(self) -> str:
        """Contract and name, as in `records.recorded`."""
        return f"{self.contract}.{self.name}"


@dataclass(frozen=True, slots=True)
class FinalizedEvents:
    """The events of one finalized block, in its order. The timestamp is the block's, ms."""

    height: int
    block_id: bytes
    timestamp_ms: int
    events: tuple[FinalizedEvent, ...]

    @property
    def checkpoint(self) -> Checkpoint:
        """The checkpoint of a store that holds this block's effects."""
        return Checkpoint(self.height, self.block_id, self.timestamp_ms)


def collect_events(height: int, block_id: bytes, timestamp_ms: int, receipts: Sequence[Receipt]) -> FinalizedEvents:
    """Return what custodians need of a finalized block's receipts. A failed call has no events."""
    events = tuple(
        FinalizedEvent(receipt.txid, event.contract, event.name, decode_value(event.data))
        for receipt in receipts
        if receipt.ok
        for event in receipt.events
        if event.contract in CUSTODY_CONTRACTS or f"{event.contract}.{event.name}" == CUSTODIANS_REMOVED
    )
    return FinalizedEvents(height, block_id, timestamp_ms, events)

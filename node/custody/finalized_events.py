"""A finalized block's events for a custodian, of four contracts, and removed custodians."""

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
    """An event: causing transaction, contract, name, decoded data."""

    txid: bytes
    contract: str
    name: str
    data: dict[str, Any]

    @property
    def kind(self) -> str:
        return f"{self.contract}.{self.name}"


@dataclass(frozen=True, slots=True)
class FinalizedEvents:
    """One finalized block's events in order; timestamp is the block's, ms."""

    height: int
    block_id: bytes
    timestamp_ms: int
    events: tuple[FinalizedEvent, ...]

    @property
    def checkpoint(self) -> Checkpoint:
        return Checkpoint(self.height, self.block_id, self.timestamp_ms)


def collect_events(height: int, block_id: bytes, timestamp_ms: int, receipts: Sequence[Receipt]) -> FinalizedEvents:
    """Failed calls have no events."""
    events = tuple(
        FinalizedEvent(receipt.txid, event.contract, event.name, decode_value(event.data))
        for receipt in receipts
        if receipt.ok
        for event in receipt.events
        if event.contract in CUSTODY_CONTRACTS or f"{event.contract}.{event.name}" == CUSTODIANS_REMOVED
    )
    return FinalizedEvents(height, block_id, timestamp_ms, events)

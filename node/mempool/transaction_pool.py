"""The pool of waiting transactions, as those who submit to it see it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

from consensus.errors import BlockRobotError
from node.limits.token_buckets import OWN, Source

PoolStatus = Literal["pending", "unknown", "expired"]


@dataclass(frozen=True, slots=True)
class SubmitResult:
    """Result of one submitted wire; `txid` is empty if undecodable."""

    txid: bytes
    error: BlockRobotError | None


class TransactionPool(Protocol):
    """The node's pool of waiting transactions."""

    async def submit(self, wires: Sequence[bytes], source: Source = OWN) -> Sequence[SubmitResult]:
        """Check and admit transactions; one result per wire, in order; known ones pass.

        `source` pays for unsigned bytes (default: this node). Raises RATE_LIMITED.
        """
        ...

    def status(self, txid: bytes) -> PoolStatus: ...

    async def wait_final(self, txid: bytes, timeout_ms: int) -> bool:
        """False on timeout or expiry."""
        ...

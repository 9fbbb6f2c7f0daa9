"""The pool of waiting transactions as clients see it, closed on certificate problems."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from consensus.errors import BlockRobotError
from node.api.services import PoolStatus, SubmitResult, TransactionPool
from node.budgets.token_buckets import OWN, Source


class ClientPool:
    """A pool, closed while the node has a problem with all its peers."""

    def __init__(self, pool: TransactionPool, problem: Callable[[], BlockRobotError | None]) -> None:
        """`problem` returns why all peers reject this node, or None."""
        self._pool = pool
        self._problem = problem

    async def submit(self, wires: Sequence[bytes], source: Source = OWN) -> Sequence[SubmitResult]:
        """As `TransactionPool.submit`. Raises NODE_REMOVED, CERTIFICATE_EXPIRED, CERTIFICATE_REVOKED."""
        problem = self._problem()
        if problem is not None:
            raise problem
        return await self._pool.submit(wires, source)

    def status(self, txid: bytes) -> PoolStatus:
        return self._pool.status(txid)

    async def wait_final(self, txid: bytes, timeout_ms: int) -> bool:
        return await self._pool.wait_final(txid, timeout_ms)

"""The pool of waiting transactions as clients see it.

A node that was removed, or whose certificate counts no more, says so at once: its clients go to another node instead of
waiting for a block that cannot come.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

from consensus.errors import BlockRobotError
from node.api.services import PoolStatus, SubmitResult, TransactionPool
from node.budgets.token_buckets import OWN, Source


class ClientPool:
    """A pool, closed while the node has a problem with all its peers."""

    def __init__(self, pool: TransactionPool, problem: Callable[[], BlockRobotError | None]) -> None:
        """`problem` says why no peer would talk to this node, if that is so."""
        self._pool = pool
        self._problem = problem

    async def submit(self, wires: Sequence[bytes], source: Source = OWN) -> Sequence[SubmitResult]:
        """As `TransactionPool.submit`. Raises NODE_REMOVED, CERTIFICATE_EXPIRED, CERTIFICATE_REVOKED."""
        problem = self._problem()
        if problem is not None:
            raise problem
        return await self._pool.submit(wires, source)

    def status(self, txid: bytes) -> PoolStatus:
        """Tell what the pool knows of a transaction that is not final."""
        return self._pool.status(txid)

    async def wait_final(self, txid: bytes, timeout_ms: int) -> bool:
        """Wait until the transaction is final; tell whether it is, or the time ran out (or it expired)."""
        return await self._pool.wait_final(txid, timeout_ms)

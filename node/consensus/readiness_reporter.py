"""Reports a candidate's readiness, while caught up, as `producers.ready`."""

from __future__ import annotations

from collections.abc import Callable

import structlog

from consensus.chain.schedule import Schedule
from consensus.chain.transaction import sign_transaction
from consensus.primitives.keys import PrivateKey
from consensus.state.producers import CANDIDATE, PRODUCERS
from node.mempool.transaction_pool import TransactionPool
from node.storage.ledger_store import LedgerSnapshot

SAY_AGAIN_MS = 5 * 60 * 1000
SAY_AGAIN_BLOCKS = 500
SAY_INTERVAL_MIN_MS = 10_000
REPORT_LIFETIME_MS = 60_000
SALT_SIZE_BYTES = 8

log = structlog.get_logger(__name__)


class ReadinessReporter:
    """Submits `producers.ready` for one producer key while a candidate without seat."""

    def __init__(
        self,
        *,
        key: PrivateKey,
        chain_id: bytes,
        pool: TransactionPool,
        reader: Callable[[], LedgerSnapshot],
        schedule: Callable[[], Schedule],
        is_close: Callable[[], bool],
        clock: Callable[[], int],
        randomness: Callable[[int], bytes],
    ) -> None:
        """`reader` gives the newest finalized state; `is_close`: caught up with peers."""
        self._key = key
        self._chain_id = chain_id
        self._pool = pool
        self._reader = reader
        self._schedule = schedule
        self._is_close = is_close
        self._clock = clock
        self._randomness = randomness
        self._said_ms: int | None = None

    async def submit_if_due(self) -> bool:
        """Submit readiness if a candidate's last is too old; return whether submitted."""
        now_ms = self._clock()
        if self._said_ms is not None and 0 <= now_ms - self._said_ms < SAY_INTERVAL_MIN_MS:
            return False
        reader = self._reader()
        position = reader.position
        if position is None or not self._is_due(reader, position.height, position.timestamp_ms):
            return False
        self._said_ms = now_ms
        report = sign_transaction(
            self._key,
            chain_id=self._chain_id,
            contract=PRODUCERS,
            entry="ready",
            arguments=[position.height, position.state_root],
            valid_until_ms=now_ms + REPORT_LIFETIME_MS,
            salt=self._randomness(SALT_SIZE_BYTES),
        )
        (result,) = await self._pool.submit([report.wire])
        code = "" if result.error is None else result.error.code
        log.info("ready_reported", height=position.height, refused=code)
        return not code

    def _is_due(self, reader: LedgerSnapshot, height: int, time_ms: int) -> bool:
        key = self._key.public_key
        if self._schedule().index_of(key) is not None:
            return False
        row = CANDIDATE.at(reader, key)
        if row is None or row.status != "candidate" or not self._is_close():
            return False
        is_old = time_ms - row.ready_ms > SAY_AGAIN_MS or height - row.ready_height > SAY_AGAIN_BLOCKS
        return row.ready_ms == 0 or is_old

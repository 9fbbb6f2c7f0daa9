"""Transaction signing; fills in chain, expiry and salt."""

from __future__ import annotations

import secrets
import time
from typing import Any, Protocol

from consensus.chain.transaction import SALT_SIZE_BYTES, Transaction, sign_transaction
from consensus.errors import BlockRobotError
from consensus.limits import TRANSACTION_LIFETIME_MAX_MS
from consensus.primitives.keys import PrivateKey

LIFETIME_DEFAULT_MS = 2 * 60_000
"""Long enough for a round of failing producers, short enough that a lost transaction is soon known to be lost."""


class Clock(Protocol):
    """The client's wall clock."""

    def now_ms(self) -> int: ...


class SystemClock:
    """The machine's clock."""

    def now_ms(self) -> int:
        return time.time_ns() // 1_000_000


class TransactionBuilder:
    """Signs calls for one chain."""

    def __init__(self, chain_id: bytes, clock: Clock | None = None) -> None:
        self.chain_id = chain_id
        self._clock = clock or SystemClock()

    def build(
        self,
        key: PrivateKey,
        contract: str,
        entry: str,
        arguments: list[Any],
        *,
        lifetime_ms: int = LIFETIME_DEFAULT_MS,
    ) -> Transaction:
        """Return a signed call with a new txid. Raises TRANSACTION_TOO_FAR_AHEAD (over ten minutes), VALUE_INVALID."""
        if not 0 < lifetime_ms <= TRANSACTION_LIFETIME_MAX_MS:
            raise BlockRobotError("TRANSACTION_TOO_FAR_AHEAD")
        return sign_transaction(
            key,
            chain_id=self.chain_id,
            contract=contract,
            entry=entry,
            arguments=arguments,
            valid_until_ms=self._clock.now_ms() + lifetime_ms,
            salt=secrets.token_bytes(SALT_SIZE_BYTES),
        )

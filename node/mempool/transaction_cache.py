"""Cache of verified transactions, keyed by the whole wire, signature included."""

from __future__ import annotations

from collections import OrderedDict

from consensus.chain.transaction import Transaction, decode_transaction

CACHE_MAX_COUNT = 32_768
CACHE_MAX_BYTES = 64 * 1024 * 1024
"""On the wire, twice a full pool; in memory a transaction takes three times as much."""


class TransactionCache:
    """A bounded map from wire bytes to verified transactions; evicts the oldest."""

    def __init__(self, max_count: int = CACHE_MAX_COUNT, max_bytes: int = CACHE_MAX_BYTES) -> None:
        self._known: OrderedDict[bytes, Transaction] = OrderedDict()
        self._max_count = max_count
        self._max_bytes = max_bytes
        self.size_bytes = 0

    def get(self, wire: bytes) -> Transaction | None:
        return self._known.get(wire)

    def verified(self, wire: bytes) -> Transaction:
        """Raises ENCODING_*, TRANSACTION_TOO_LARGE, SIGNATURE_INVALID or SIGNATURE_HIGH_S."""
        transaction = self._known.get(wire)
        if transaction is None:
            transaction = decode_transaction(wire)
            transaction.verify_sender()
            self.add(transaction)
        return transaction

    def add(self, transaction: Transaction) -> None:
        if transaction.wire not in self._known:
            self.size_bytes += len(transaction.wire)
        self._known[transaction.wire] = transaction
        while len(self._known) > self._max_count or self.size_bytes > self._max_bytes:
            wire, _ = self._known.popitem(last=False)
            self.size_bytes -= len(wire)

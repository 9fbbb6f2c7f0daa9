"""Cache of verified transactions, keyed by the whole wire, signature included."""

from __future__ import annotations

from collections import OrderedDict

from consensus.chain.transaction import Transaction, decode_transaction

CACHE_MAX_COUNT = 32_768


class TransactionCache:
    """A bounded map from wire bytes to verified transactions; evicts the oldest."""

    def __init__(self, max_count: int = CACHE_MAX_COUNT) -> None:
        self._known: OrderedDict[bytes, Transaction] = OrderedDict()
        self._max_count = max_count

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
        self._known[transaction.wire] = transaction
        if len(self._known) > self._max_count:
            self._known.popitem(last=False)

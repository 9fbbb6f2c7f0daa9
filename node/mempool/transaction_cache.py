"""Transactions that this node has already decoded and whose signature it has already checked.

A transaction comes more than once: from a client, by gossip, in a proposal. The key is the whole wire, signature
included, so that another signature over the same body is checked on its own.
"""

from __future__ import annotations

from collections import OrderedDict

from consensus.chain.transaction import Transaction, decode_transaction

CACHE_MAX_COUNT = 32_768


class TransactionCache:
    """A bounded map from wire bytes to the verified transaction; the oldest go first."""

    def __init__(self, max_count: int = CACHE_MAX_COUNT) -> None:
        self._known: OrderedDict[bytes, Transaction] = OrderedDict()
        self._max_count = max_count

    def get(self, wire: bytes) -> Transaction | None:
        """Return the verified transaction of exactly these bytes, if it was seen."""
        return self._known.get(wire)

    def verified(self, wire: bytes) -> Transaction:
        """Return the transaction of these bytes, decoded and with its sender checked, once.

        Raises ENCODING_*, TRANSACTION_TOO_LARGE, SIGNATURE_INVALID or SIGNATURE_HIGH_S.
        """
        transaction = self._known.get(wire)
        if transaction is None:
            transaction = decode_transaction(wire)
            transaction.verify_sender()
            self.add(transaction)
        return transaction

    def add(self, transaction: Transaction) -> None:
        """Remember a transaction whose sender was checked."""
        self._known[transaction.wire] = transaction
        if len(self._known) > self._max_count:
            self._known.popitem(last=False)

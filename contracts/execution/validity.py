"""Transaction validity before execution: time order, ten-minute expiry and unique txids prevent replay."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from consensus.limits import BLOCK_SIZE_MAX_BYTES, BLOCK_TRANSACTIONS_MAX_COUNT, TRANSACTION_LIFETIME_MAX_MS


class RecentTransactions(Protocol):
    """Txids in one branch's last ten minutes."""

    def __contains__(self, txid: object, /) -> bool: ...


def check_transaction(transaction: Transaction, chain_id: bytes, time_ms: int, recent: RecentTransactions) -> None:
    """Check against block time and branch, not the signature.

    Raises TRANSACTION_WRONG_CHAIN, TRANSACTION_EXPIRED, TRANSACTION_TOO_FAR_AHEAD or TRANSACTION_REPLAYED.
    """
    body = transaction.body
    if body.chain_id != chain_id:
        raise BlockRobotError("TRANSACTION_WRONG_CHAIN")
    if body.valid_until_ms <= time_ms:
        raise BlockRobotError("TRANSACTION_EXPIRED")
    if body.valid_until_ms > time_ms + TRANSACTION_LIFETIME_MAX_MS:
        raise BlockRobotError("TRANSACTION_TOO_FAR_AHEAD")
    if transaction.txid in recent:
        raise BlockRobotError("TRANSACTION_REPLAYED")


def check_block_transactions(
    transactions: Sequence[Transaction],
    *,
    chain_id: bytes,
    parent_time_ms: int,
    time_ms: int,
    recent: RecentTransactions,
) -> None:
    """Check a block's time and transactions. Raises BLOCK_INVALID or as `check_transaction`."""
    if time_ms <= parent_time_ms:
        raise BlockRobotError("BLOCK_INVALID", "The block's time does not lie after its parent's.")
    if len(transactions) > BLOCK_TRANSACTIONS_MAX_COUNT:
        raise BlockRobotError("BLOCK_INVALID", "The block has too many transactions.")
    if sum(len(transaction.wire) for transaction in transactions) > BLOCK_SIZE_MAX_BYTES:
        raise BlockRobotError("BLOCK_INVALID", "The block is too large.")
    if len({transaction.txid for transaction in transactions}) != len(transactions):
        raise BlockRobotError("BLOCK_INVALID", "The block holds a transaction twice.")
    for transaction in transactions:
        check_transaction(transaction, chain_id, time_ms, recent)


def select_valid(
    transactions: Sequence[Transaction], *, chain_id: bytes, time_ms: int, recent: RecentTransactions
) -> list[Transaction]:
    """Return valid transactions for this block time, in order, each once."""
    chosen: dict[bytes, Transaction] = {}
    for transaction in transactions:
        try:
            check_transaction(transaction, chain_id, time_ms, recent)
        except BlockRobotError:
            continue
        chosen.setdefault(transaction.txid, transaction)
    return list(chosen.values())

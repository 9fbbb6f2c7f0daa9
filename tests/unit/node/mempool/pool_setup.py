"""A mempool and signed transactions for the tests of this folder and of `tests/property`."""

from __future__ import annotations

from typing import Any

from consensus.chain.transaction import Transaction, sign_transaction
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from node.mempool.mempool import Mempool
from node.mempool.transaction_cache import TransactionCache

CHAIN = sha256(b"a chain")
NOW_MS = 1_700_000_000_000


def sender(number: int) -> PrivateKey:
    return PrivateKey(sha256(b"sender %d" % number))


def transaction(number: int, *, by: int = 0, contract: str = "records", **changes: Any) -> Transaction:
    """The transaction with this number of a sender; equal arguments give equal bytes."""
    fields: dict[str, Any] = {
        "chain_id": CHAIN,
        "contract": contract,
        "entry": "record",
        "arguments": [number],
        "valid_until_ms": NOW_MS + 60_000,
        "salt": number.to_bytes(8, "big"),
    }
    return sign_transaction(sender(by), **(fields | changes))


def make_pool(**changes: Any) -> Mempool:
    """A pool in which everybody has standing and nothing is spent, unless said otherwise."""
    fields: dict[str, Any] = {
        "chain_id": CHAIN,
        "cache": TransactionCache(),
        "check_admission": lambda _: True,
        "is_spent": lambda _: False,
    }
    return Mempool(**(fields | changes))


def take_all(pool: Mempool, max_count: int = 256, max_bytes: int = 1 << 20) -> list[Transaction]:
    return pool.take(max_count=max_count, max_bytes=max_bytes, timestamp_ms=NOW_MS)

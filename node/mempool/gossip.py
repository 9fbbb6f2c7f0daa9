"""Passes transactions on to all peers: at once when idle, otherwise in batches."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterable

from consensus.chain.transaction import Transaction
from consensus.primitives.encoding import encode
from node.p2p.wire import TransactionBatch

BATCH_INTERVAL_MS = 5
BATCH_MAX_BYTES = 512 * 1024
AGAIN_MAX_BYTES = 1024 * 1024


def batches(transactions: Iterable[Transaction], max_bytes: int = BATCH_MAX_BYTES) -> Iterable[bytes]:
    wires: list[bytes] = []
    size = 0
    for transaction in transactions:
        if wires and size + len(transaction.wire) > max_bytes:
            yield encode(TransactionBatch(transactions=tuple(wires)))
            wires, size = [], 0
        wires.append(transaction.wire)
        size += len(transaction.wire)
    if wires:
        yield encode(TransactionBatch(transactions=tuple(wires)))


def oldest_within(transactions: list[Transaction], max_bytes: int) -> list[Transaction]:
    kept: list[Transaction] = []
    for transaction in transactions:
        max_bytes -= len(transaction.wire)
        if max_bytes < 0:
            break
        kept.append(transaction)
    return kept


class Gossip:
    """Passes on what this node received from clients."""

    def __init__(self, send: Callable[[bytes], None]) -> None:
        """`send` sends the payload of a batch to all peers."""
        self._send = send
        self._loop = asyncio.get_running_loop()
        self._waiting: list[Transaction] = []
        self._timer: asyncio.TimerHandle | None = None

    def offer(self, transactions: list[Transaction]) -> None:
        if not transactions:
            return
        self._waiting += transactions
        if self._timer is None:
            self._flush()

    def repeat(self, transactions: list[Transaction]) -> None:
        for payload in batches(oldest_within(transactions, AGAIN_MAX_BYTES)):
            self._send(payload)

    def stop(self) -> None:
        if self._timer is not None:
            self._timer.cancel()

    def _flush(self) -> None:
        self._timer = None
        if not self._waiting:
            return
        waiting, self._waiting = self._waiting, []
        for payload in batches(waiting):
            self._send(payload)
        self._timer = self._loop.call_later(BATCH_INTERVAL_MS / 1000, self._flush)

"""Transactions that wait for a block. Must never grow without bound, and never let one sender keep the others out.

Senders take turns, first come first served within each. Whoever has a visit makes as many grantees' keys as she likes:
they all take one sender's turns, and each of them a sixteenth of its room at most. A tenth of the room, and of every
block, is kept for the calls by which people exercise control of their data, so that no flood of records delays an
erasure.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass

from consensus.errors import BlockRobotError
from consensus.limits import TRANSACTION_LIFETIME_MAX_MS
from consensus.transaction import Transaction, decode_transaction
from node.transaction_cache import TransactionCache

POOL_MAX_BYTES = 32 * 1024 * 1024
SENDER_MAX_COUNT = 1024
SENDER_MAX_BYTES = 4 * 1024 * 1024
SHARED_DIVISOR = 16
"""What part of the room of an account that many keys share one of them may take."""
RESERVED_DIVISOR = 10
RESERVED_CONTRACTS = frozenset(
    {
        "access",
        "consent",
        "erasure",
        "evidence",
        "identity",
        "membership",
        "officers",
        "producers",
        "rights",
        "settings",
    }
)
RESERVED_CALLS = frozenset({("records", "transfer")})
"""Calls of other contracts that have it too: a stolen wallet's visits are moved as soon as what the thief asks for."""


@dataclass(slots=True)
class _Entry:
    transaction: Transaction
    reserved: bool
    roomy_blocks_at_start: int
    account: bytes


@dataclass(slots=True)
class _Load:
    count: int = 0
    size_bytes: int = 0


class Mempool:
    """The pool. All its parts run on the node's event loop."""

    def __init__(
        self,
        *,
        chain_id: bytes,
        cache: TransactionCache,
        has_standing: Callable[[Transaction], bool],
        is_spent: Callable[[bytes], bool],
        account_of: Callable[[Transaction], bytes] = lambda transaction: transaction.body.sender,
        max_bytes: int = POOL_MAX_BYTES,
        sender_max_count: int = SENDER_MAX_COUNT,
        sender_max_bytes: int = SENDER_MAX_BYTES,
    ) -> None:
        """`has_standing` looks at the finalized state; `is_spent` tells of a txid if it is on the branch or final.

        `account_of` says in whose turns a transaction is taken that has standing: its sender's, or those that he shares.
        """
        self._chain_id = chain_id
        self._cache = cache
        self._has_standing = has_standing
        self._is_spent = is_spent
        self._account_of = account_of
        self._max_bytes = max_bytes
        self._ordinary_max_bytes = max_bytes - max_bytes // RESERVED_DIVISOR
        self._sender_max_count = sender_max_count
        self._sender_max_bytes = sender_max_bytes
        self._entries: dict[bytes, _Entry] = {}
        self._accounts: OrderedDict[bytes, dict[bytes, _Entry]] = OrderedDict()
        self._reserved_accounts: OrderedDict[bytes, dict[bytes, _Entry]] = OrderedDict()
        self._loads: dict[bytes, _Load] = {}  # of accounts, and of senders who share one
        self._roomy_blocks = 0
        self.size_bytes = 0
        self.ordinary_bytes = 0

    def __len__(self) -> int:
        return len(self._entries)

    def __contains__(self, txid: object) -> bool:
        return txid in self._entries

    def get(self, txid: bytes) -> Transaction | None:
        """Return a waiting transaction."""
        entry = self._entries.get(txid)
        return None if entry is None else entry.transaction

    def transactions(self) -> list[Transaction]:
        """Return all that wait, oldest first."""
        return [entry.transaction for entry in self._entries.values()]

    # Admission

    def admit(
        self, wire: bytes, now_ms: int, also: Callable[[Transaction], None] | None = None
    ) -> tuple[Transaction, bool]:
        """Check a transaction and let it wait; return it and whether it is new here. `also` may refuse it by raising.

        Raises ENCODING_*, TRANSACTION_TOO_LARGE, TRANSACTION_WRONG_CHAIN, TRANSACTION_EXPIRED,
        TRANSACTION_TOO_FAR_AHEAD, TRANSACTION_REPLAYED, SENDER_LIMIT, MEMPOOL_FULL, SIGNATURE_*,
        SENDER_WITHOUT_STANDING or what `has_standing` raises. The cheap checks come first, the signature after them.
        """
        known = self._cache.get(wire)
        transaction = decode_transaction(wire) if known is None else known
        if transaction.txid in self._entries:
            return transaction, False
        self._require_timely(transaction, now_ms)
        if self._is_spent(transaction.txid):
            raise BlockRobotError("TRANSACTION_REPLAYED")
        body = transaction.body
        reserved = body.contract in RESERVED_CONTRACTS or (body.contract, body.entry) in RESERVED_CALLS
        self._require_room(transaction, reserved=reserved)
        if known is None:
            transaction.verify_sender()
        if not self._has_standing(transaction):
            raise BlockRobotError("SENDER_WITHOUT_STANDING")
        account = self._account_of(transaction)
        if account != body.sender:
            self._require_share(body.sender, len(wire), SHARED_DIVISOR)
            self._require_share(account, len(wire))
        if also is not None:
            also(transaction)
        if known is None:
            self._cache.add(transaction)
        self._insert(transaction, account, reserved=reserved)
        return transaction, True

    def _require_timely(self, transaction: Transaction, now_ms: int) -> None:
        body = transaction.body
        if body.chain_id != self._chain_id:
            raise BlockRobotError("TRANSACTION_WRONG_CHAIN")
        if body.valid_until_ms <= now_ms:
            raise BlockRobotError("TRANSACTION_EXPIRED")
        if body.valid_until_ms > now_ms + TRANSACTION_LIFETIME_MAX_MS:
            raise BlockRobotError("TRANSACTION_TOO_FAR_AHEAD")

    def _require_room(self, transaction: Transaction, *, reserved: bool) -> None:
        size = len(transaction.wire)
        self._require_share(transaction.body.sender, size)
        if self.size_bytes + size > self._max_bytes or (
            not reserved and self.ordinary_bytes + size > self._ordinary_max_bytes
        ):
            raise BlockRobotError("MEMPOOL_FULL")

    def _require_share(self, name: bytes, size_bytes: int, divisor: int = 1) -> None:
        load = self._loads.get(name, _Load())
        too_many = load.count >= max(1, self._sender_max_count // divisor)
        if too_many or load.size_bytes + size_bytes > self._sender_max_bytes // divisor:
            raise BlockRobotError("SENDER_LIMIT")

    def _insert(self, transaction: Transaction, account: bytes, *, reserved: bool) -> None:
        entry = _Entry(transaction, reserved, self._roomy_blocks, account)
        size = len(transaction.wire)
        self._entries[transaction.txid] = entry
        lane = self._reserved_accounts if reserved else self._accounts
        lane.setdefault(account, {})[transaction.txid] = entry
        for name in {account, transaction.body.sender}:
            load = self._loads.setdefault(name, _Load())
            load.count, load.size_bytes = load.count + 1, load.size_bytes + size
        self.size_bytes += size
        self.ordinary_bytes += 0 if reserved else size

    # Leaving

    def remove(self, txids: Iterable[bytes]) -> int:
        """Take out what became final, or what cannot be executed; return how many were here."""
        count = 0
        for txid in txids:
            entry = self._entries.pop(txid, None)
            if entry is None:
                continue
            count += 1
            size = len(entry.transaction.wire)
            lane = self._reserved_accounts if entry.reserved else self._accounts
            queue = lane[entry.account]
            del queue[txid]
            if not queue:
                del lane[entry.account]
            for name in {entry.account, entry.transaction.body.sender}:
                load = self._loads[name]
                load.count, load.size_bytes = load.count - 1, load.size_bytes - size
                if not load.count:
                    del self._loads[name]
            self.size_bytes -= size
            self.ordinary_bytes -= 0 if entry.reserved else size
        return count

    def purge_expired(self, now_ms: int) -> list[bytes]:
        """Take out what would not be admitted at `now_ms`: too old, or (the clock was put back) too far ahead.

        Returns the txids.
        """
        expired = [txid for txid, entry in self._entries.items() if not _is_timely(entry.transaction, now_ms)]
        self.remove(expired)
        return expired

    # Blocks

    def take(
        self, *, max_count: int, max_bytes: int, timestamp_ms: int, exclude: Collection[bytes] = ()
    ) -> list[Transaction]:
        """Choose transactions for a block with this timestamp; they stay here until they are final.

        First up to a tenth of the block from the reserved lane, then round robin over all accounts, the reserved ones
        first in each turn. `exclude` holds the txids of the branch.
        """
        taken: list[Transaction] = []
        chosen: set[bytes] = set()
        self._fill(
            (self._reserved_accounts,),
            taken,
            chosen,
            max(1, max_count // RESERVED_DIVISOR),
            max_bytes // RESERVED_DIVISOR,
            timestamp_ms,
            exclude,
        )
        self._fill(
            (self._reserved_accounts, self._accounts), taken, chosen, max_count, max_bytes, timestamp_ms, exclude
        )
        return taken

    def _fill(
        self,
        lanes: tuple[OrderedDict[bytes, dict[bytes, _Entry]], ...],
        taken: list[Transaction],
        chosen: set[bytes],
        max_count: int,
        max_bytes: int,
        timestamp_ms: int,
        exclude: Collection[bytes],
    ) -> None:
        size = sum(len(transaction.wire) for transaction in taken)
        turns = [(lane, account, iter(list(queue.values()))) for lane in lanes for account, queue in lane.items()]
        served: list[tuple[OrderedDict[bytes, dict[bytes, _Entry]], bytes]] = []
        while turns and len(taken) < max_count:
            remaining = []
            for lane, account, queue in turns:
                if len(taken) >= max_count:
                    break
                for entry in queue:
                    transaction = entry.transaction
                    txid = transaction.txid
                    if txid in exclude or txid in chosen or not _is_timely(transaction, timestamp_ms):
                        continue
                    if size + len(transaction.wire) > max_bytes:
                        continue
                    taken.append(transaction)
                    chosen.add(txid)
                    size += len(transaction.wire)
                    served.append((lane, account))
                    remaining.append((lane, account, queue))
                    break
            turns = remaining
        for lane, account in served:
            lane.move_to_end(account)

    def note_block(self, *, is_roomy: bool) -> None:
        """A block was certified; `is_roomy` if it had room left, so that what it lacks was left out by choice."""
        self._roomy_blocks += is_roomy

    def has_work(self, exclude: Collection[bytes], patience_blocks: int) -> bool:
        """Tell whether a transaction outside the branch is worth a block: not left out of too many roomy ones."""
        newest = self._roomy_blocks - patience_blocks
        return any(
            entry.roomy_blocks_at_start > newest and txid not in exclude
            for txid, entry in reversed(self._entries.items())
        )


def _is_timely(transaction: Transaction, timestamp_ms: int) -> bool:
    valid_until_ms = transaction.body.valid_until_ms
    return timestamp_ms < valid_until_ms <= timestamp_ms + TRANSACTION_LIFETIME_MAX_MS

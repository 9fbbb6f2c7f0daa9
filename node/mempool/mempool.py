"""Transactions that wait for a block: accounts take turns, FIFO within each.

A visit's grantees share one account's turns. A tenth of room and blocks is reserved for data-control calls. When full,
large accounts lose their newest.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field

from consensus.chain.transaction import Transaction, decode_transaction
from consensus.errors import BlockRobotError
from consensus.limits import BLOCK_TRANSACTIONS_MAX_COUNT, TRANSACTION_LIFETIME_MAX_MS
from consensus.state.layout import RESERVED_CALLS, RESERVED_CONTRACTS
from contracts.execution.sender_admission import Account
from node.limits.account_byte_limiter import AccountByteLimiter
from node.mempool.eviction_policy import EvictionPlan
from node.mempool.lane import Lane
from node.mempool.transaction_cache import TransactionCache

POOL_MAX_BYTES = 32 * 1024 * 1024
SENDER_MAX_COUNT = 1024
SENDER_MAX_BYTES = 4 * 1024 * 1024
SHARED_DIVISOR = 16
"""What part of the room of an account that many keys share one of them may take."""
RESERVED_DIVISOR = 10
BLOCK_SHARE_COUNT = BLOCK_TRANSACTIONS_MAX_COUNT // 8
"""So many transactions of one account in a block at most: full blocks take longer, for everybody."""
BLOCK_SHARE_OF_ORIGIN_COUNT = 2 * BLOCK_SHARE_COUNT
"""The same for all visits that one robot opened, some of which may be under keys of its own."""


@dataclass(slots=True)
class _Entry:
    transaction: Transaction
    reserved: bool
    roomy_blocks_at_start: int
    payer: Account

    @property
    def account(self) -> str:
        return self.payer.name

    @property
    def is_of_visit(self) -> bool:
        return self.payer.is_of_visit

    @property
    def size_bytes(self) -> int:
        return len(self.transaction.wire)


@dataclass(frozen=True, slots=True)
class Screened:
    """A transaction after the cheap checks; `is_waiting`: already here.

    `refusal`: why it may not wait, for its signer alone.
    """

    transaction: Transaction
    account: Account
    reserved: bool
    is_verified: bool
    is_waiting: bool
    refusal: BlockRobotError | None = None


@dataclass(slots=True)
class _Load:
    count: int = 0
    size_bytes: int = 0


class Mempool:
    """The mempool; runs on the node's event loop."""

    def __init__(
        self,
        *,
        chain_id: bytes,
        cache: TransactionCache,
        check_admission: Callable[[Transaction], bool],
        is_spent: Callable[[bytes], bool],
        account_of: Callable[[Transaction], Account] = lambda transaction: Account(
            f"key {transaction.body.sender.hex()}"
        ),
        max_bytes: int = POOL_MAX_BYTES,
        sender_max_count: int = SENDER_MAX_COUNT,
        sender_max_bytes: int = SENDER_MAX_BYTES,
        byte_budgets: AccountByteLimiter | None = None,
    ) -> None:
        """`is_spent`: whether a txid is on the branch or final; `account_of`: whose turns count."""
        self._chain_id = chain_id
        self._cache = cache
        self._check_admission = check_admission
        self._is_spent = is_spent
        self.account_of = account_of
        self.max_bytes = max_bytes
        self._ordinary_max_bytes = max_bytes - max_bytes // RESERVED_DIVISOR
        self._sender_max_count = sender_max_count
        self._sender_max_bytes = sender_max_bytes
        self._byte_budgets = byte_budgets or AccountByteLimiter()
        self._entries: dict[bytes, _Entry] = {}
        self._ordinary: Lane[_Entry] = Lane()
        self._reserved: Lane[_Entry] = Lane()
        self._loads: dict[str, _Load] = {}  # of accounts, and of senders who share one
        self._roomy_blocks = 0
        self.evicted_count = 0

    @property
    def size_bytes(self) -> int:
        return self._ordinary.size_bytes + self._reserved.size_bytes

    @property
    def ordinary_bytes(self) -> int:
        return self._ordinary.size_bytes

    def __len__(self) -> int:
        return len(self._entries)

    def __contains__(self, txid: object) -> bool:
        return txid in self._entries

    def get(self, txid: bytes) -> Transaction | None:
        entry = self._entries.get(txid)
        return None if entry is None else entry.transaction

    def transactions(self) -> list[Transaction]:
        return [entry.transaction for entry in self._entries.values()]

    # Admission

    def admit(
        self, wire: bytes, now_ms: int, also: Callable[[Transaction], None] | None = None
    ) -> tuple[Transaction, bool]:
        """Check and add; return the transaction and whether it is new.

        Raises as `read`, `screen` and `insert`, `also`'s errors, and SIGNATURE_*.
        """
        transaction, is_verified = self.read(wire)
        screened = self.screen(transaction, now_ms, also, is_verified=is_verified)
        if not screened.is_verified:
            transaction.verify_sender()
        return self.insert(screened)

    def read(self, wire: bytes) -> tuple[Transaction, bool]:
        """Return the transaction and whether its signature was checked before.

        Raises ENCODING_*, TRANSACTION_TOO_LARGE.
        """
        known = self._cache.get(wire)
        return (decode_transaction(wire), False) if known is None else (known, True)

    def screen(
        self,
        transaction: Transaction,
        now_ms: int,
        also: Callable[[Transaction], None] | None = None,
        *,
        is_verified: bool,
    ) -> Screened:
        """Do all checks except the signature's; `also` may raise.

        Sender-specific errors go to `refusal`: unsigned calls reveal no membership. Raises TRANSACTION_WRONG_CHAIN,
        TRANSACTION_EXPIRED, TRANSACTION_TOO_FAR_AHEAD, TRANSACTION_REPLAYED, MEMPOOL_FULL, SENDER_NOT_ADMITTED or as
        `check_admission`.
        """
        if transaction.txid in self._entries:
            return Screened(transaction, Account(""), reserved=False, is_verified=True, is_waiting=True)
        self._require_timely(transaction, now_ms)
        if self._is_spent(transaction.txid):
            raise BlockRobotError("TRANSACTION_REPLAYED")
        body = transaction.body
        reserved = body.contract in RESERVED_CONTRACTS or (body.contract, body.entry) in RESERVED_CALLS
        if not self._check_admission(transaction):
            raise BlockRobotError("SENDER_NOT_ADMITTED")
        account = self.account_of(transaction)
        self._plan_evictions(
            transaction, account, reserved
        )  # for its refusal alone: nothing leaves for who has not signed
        refusal = None
        try:
            self._require_shares(transaction, account)
            if also is not None:
                also(transaction)
        except BlockRobotError as error:
            refusal = error
        return Screened(transaction, account, reserved, is_verified, False, refusal)

    def insert(self, screened: Screened) -> tuple[Transaction, bool]:
        """Add a screened transaction with checked signature; return it and whether new.

        Raises its `refusal`, RATE_LIMITED, TRANSACTION_REPLAYED, SENDER_LIMIT, MEMPOOL_FULL, changing nothing.
        """
        transaction = screened.transaction
        if screened.refusal is not None:
            raise screened.refusal
        if screened.is_waiting or transaction.txid in self._entries:
            return transaction, False
        if self._is_spent(transaction.txid):
            raise BlockRobotError("TRANSACTION_REPLAYED")
        self._require_shares(transaction, screened.account)
        evicted = self._plan_evictions(transaction, screened.account, screened.reserved)
        self._byte_budgets.take(screened.account, len(transaction.wire))
        self._evict(evicted)
        if not screened.is_verified:
            self._cache.add(transaction)
        self._insert(transaction, screened.account, reserved=screened.reserved)
        return transaction, True

    def _require_shares(self, transaction: Transaction, account: Account) -> None:
        size = len(transaction.wire)
        self._require_share(account.name, size)
        if account.is_shared:
            self._require_share(account.name_payer(transaction.body.sender), size, SHARED_DIVISOR)

    def _require_timely(self, transaction: Transaction, now_ms: int) -> None:
        body = transaction.body
        if body.chain_id != self._chain_id:
            raise BlockRobotError("TRANSACTION_WRONG_CHAIN")
        if body.valid_until_ms <= now_ms:
            raise BlockRobotError("TRANSACTION_EXPIRED")
        if body.valid_until_ms > now_ms + TRANSACTION_LIFETIME_MAX_MS:
            raise BlockRobotError("TRANSACTION_TOO_FAR_AHEAD")

    def _plan_evictions(self, transaction: Transaction, account: Account, reserved: bool) -> Collection[bytes]:
        """Raises MEMPOOL_FULL."""
        size = len(transaction.wire)
        over_ordinary = 0 if reserved else self.ordinary_bytes + size - self._ordinary_max_bytes
        over_all = self.size_bytes + size - self.max_bytes
        if over_ordinary > 0:
            lanes = [self._ordinary]
        elif over_all > 0:
            lanes = sorted([self._ordinary, self._reserved], key=lambda lane: lane.largest_bytes, reverse=True)
        else:
            return ()
        waiting = self._ordinary.size_of(account.name) + self._reserved.size_of(account.name)
        plan = EvictionPlan(lanes, max(over_ordinary, over_all))
        return plan.choose(account, size + waiting, is_first=not waiting)

    def _evict(self, txids: Collection[bytes]) -> None:
        for txid in txids:
            entry = self._entries[txid]
            self._byte_budgets.refund(entry.payer, entry.size_bytes)
        self.evicted_count += self.remove(txids)

    def _require_share(self, name: str, size_bytes: int, divisor: int = 1) -> None:
        load = self._loads.get(name, _Load())
        too_many = load.count >= max(1, self._sender_max_count // divisor)
        if too_many or load.size_bytes + size_bytes > self._sender_max_bytes // divisor:
            raise BlockRobotError("SENDER_LIMIT")

    def _insert(self, transaction: Transaction, account: Account, *, reserved: bool) -> None:
        entry = _Entry(transaction, reserved, self._roomy_blocks, account)
        size = len(transaction.wire)
        self._entries[transaction.txid] = entry
        (self._reserved if reserved else self._ordinary).add(transaction.txid, entry)
        for name in dict.fromkeys((account.name, account.name_payer(transaction.body.sender))):
            load = self._loads.setdefault(name, _Load())
            load.count, load.size_bytes = load.count + 1, load.size_bytes + size

    # Leaving

    def remove(self, txids: Iterable[bytes]) -> int:
        count = 0
        for txid in txids:
            entry = self._entries.pop(txid, None)
            if entry is None:
                continue
            count += 1
            (self._reserved if entry.reserved else self._ordinary).remove(txid, entry)
            for name in dict.fromkeys((entry.account, entry.payer.name_payer(entry.transaction.body.sender))):
                load = self._loads[name]
                load.count, load.size_bytes = load.count - 1, load.size_bytes - entry.size_bytes
                if not load.count:
                    del self._loads[name]
        return count

    def purge_expired(self, now_ms: int) -> list[bytes]:
        """Remove what is expired or too far ahead at `now_ms`; return the txids."""
        expired = [txid for txid, entry in self._entries.items() if not _is_timely(entry.transaction, now_ms)]
        self.remove(expired)
        return expired

    # Blocks

    def take(
        self, *, max_count: int, max_bytes: int, timestamp_ms: int, exclude: Collection[bytes] = ()
    ) -> list[Transaction]:
        """Choose transactions for a block; they stay until final. `exclude`: the branch's txids.

        Up to a tenth from the reserved lane first, then round robin, `BLOCK_SHARE_COUNT` of an account at most.
        """
        selection = _Selection(timestamp_ms, exclude)
        selection.fill((self._reserved,), max(1, max_count // RESERVED_DIVISOR), max_bytes // RESERVED_DIVISOR)
        selection.fill((self._reserved, self._ordinary), max_count, max_bytes)
        return list(selection.chosen.values())

    def note_block(self, *, is_roomy: bool) -> None:
        """`is_roomy`: the certified block had room left."""
        self._roomy_blocks += is_roomy

    def has_work(self, exclude: Collection[bytes], patience_blocks: int) -> bool:
        """Return whether any transaction off the branch deserves a block."""
        newest = self._roomy_blocks - patience_blocks
        return any(
            entry.roomy_blocks_at_start > newest and txid not in exclude
            for txid, entry in reversed(self._entries.items())
        )


@dataclass(slots=True)
class _Selection:
    """What a block gets so far, by txid; `shares`: how many of an account, and of all visits of one origin."""

    timestamp_ms: int
    exclude: Collection[bytes]
    chosen: dict[bytes, Transaction] = field(default_factory=dict)
    shares: Counter[str] = field(default_factory=Counter)
    size_bytes: int = 0

    def fill(self, lanes: Sequence[Lane[_Entry]], max_count: int, max_bytes: int) -> None:
        """Accounts take turns; who was served goes to the end of their lane."""
        turns = [
            (lane, account, iter(list(queue.values()))) for lane in lanes for account, queue in lane.queues.items()
        ]
        served: list[tuple[Lane[_Entry], str]] = []
        while turns and len(self.chosen) < max_count:
            remaining = []
            for lane, account, queue in turns:
                if len(self.chosen) >= max_count:
                    break
                entry = next((one for one in queue if self._takes(one, max_bytes)), None)
                if entry is not None:
                    self._add(entry)
                    served.append((lane, account))
                    remaining.append((lane, account, queue))
            turns = remaining
        for lane, account in served:
            lane.queues.move_to_end(account)

    def _takes(self, entry: _Entry, max_bytes: int) -> bool:
        transaction, origin = entry.transaction, entry.payer.origin
        return (
            self.shares[entry.account] < BLOCK_SHARE_COUNT
            and (not origin or self.shares[origin] < BLOCK_SHARE_OF_ORIGIN_COUNT)
            and transaction.txid not in self.exclude
            and transaction.txid not in self.chosen
            and self.size_bytes + entry.size_bytes <= max_bytes
            and _is_timely(transaction, self.timestamp_ms)
        )

    def _add(self, entry: _Entry) -> None:
        self.chosen[entry.transaction.txid] = entry.transaction
        self.size_bytes += entry.size_bytes
        self.shares.update([entry.account, *([entry.payer.origin] if entry.payer.origin else [])])


def _is_timely(transaction: Transaction, timestamp_ms: int) -> bool:
    valid_until_ms = transaction.body.valid_until_ms
    return timestamp_ms < valid_until_ms <= timestamp_ms + TRANSACTION_LIFETIME_MAX_MS

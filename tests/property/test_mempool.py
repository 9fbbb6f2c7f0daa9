"""Whatever comes and goes, in any order: the pool keeps its accounts, its bounds and everybody's turn."""

from __future__ import annotations

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from contracts.execution.sender_admission import Account
from node.limits.account_byte_limiter import AccountByteLimiter
from tests.unit.node.mempool.pool_setup import NOW_MS, make_pool, sender, transaction

SENDERS, NUMBERS = 12, 12
VISITS = {sender(by).public_key for by in range(4, SENDERS)}
POOL_MAX_BYTES, SENDER_MAX_COUNT = 4_000, 6
BURST_BYTES = 6_000
CONTRACTS = ("records", "erasure")
PADDING_BYTES = (0, 0, 0, 700)

TRANSACTIONS = {
    (by, number): transaction(
        number,
        by=by,
        contract=CONTRACTS[number % 2],
        arguments=[bytes(PADDING_BYTES[(by + number // 2) % 4])],
        valid_until_ms=NOW_MS + 100 * (1 + number),
    )
    for by in range(SENDERS)
    for number in range(NUMBERS)
}


class PoolMachine(RuleBasedStateMachine):
    def __init__(self) -> None:
        super().__init__()
        self.budgets = AccountByteLimiter(lambda: 0.0, bytes_per_s=1, burst_bytes=BURST_BYTES)
        self.pool = make_pool(
            max_bytes=POOL_MAX_BYTES,
            sender_max_count=SENDER_MAX_COUNT,
            byte_budgets=self.budgets,
            account_of=lambda item: Account(item.body.sender, item.body.sender in VISITS),
        )
        self.model: dict[bytes, Transaction] = {}
        self.paid = dict.fromkeys((sender(by).public_key for by in range(SENDERS)), 0)
        self.now_ms = NOW_MS

    @rule(by=st.integers(0, SENDERS - 1), number=st.integers(0, NUMBERS - 1))
    def admit(self, by: int, number: int) -> None:
        wanted = TRANSACTIONS[by, number]
        refusal, is_new, evicted_before, before = "", False, self.pool.evicted_count, self.pool.transactions()
        try:
            _, is_new = self.pool.admit(wanted.wire, self.now_ms)
        except BlockRobotError as error:
            refusal = error.code
        assert refusal in {"", "SENDER_LIMIT", "MEMPOOL_FULL", "TRANSACTION_EXPIRED", "RATE_LIMITED"}
        assert (wanted.txid in self.model) == (not refusal and not is_new)
        if refusal or not is_new:
            assert (self.pool.transactions(), self.pool.evicted_count) == (before, evicted_before)
            return
        self.model[wanted.txid] = wanted
        self.paid[wanted.body.sender] += len(wanted.wire)
        evicted = [self.model.pop(txid) for txid in list(self.model) if txid not in self.pool]
        assert len(evicted) == self.pool.evicted_count - evicted_before
        assert wanted.body.sender not in {item.body.sender for item in evicted}
        for item in evicted:
            self.paid[item.body.sender] -= len(item.wire)
        rights = sum(len(item.wire) for item in before if item.body.contract != "records")
        if wanted.body.contract == "records" and rights <= POOL_MAX_BYTES // 10:
            assert all(item.body.contract == "records" for item in evicted)
        own = sum(len(item.wire) for item in self.model.values() if item.body.sender == wanted.body.sender)
        if wanted.body.sender in VISITS:
            for item in evicted:
                if item.body.sender not in VISITS:
                    assert sum(len(e.wire) for e in before if e.body.sender == item.body.sender) >= 4 * own

    @rule(data=st.data())
    def finalize_some(self, data: st.DataObject) -> None:
        if self.model:
            chosen = data.draw(st.sets(st.sampled_from(sorted(self.model))))
            assert self.pool.remove(chosen) == len(chosen)
            for txid in chosen:
                del self.model[txid]

    @rule(later_ms=st.integers(0, 300))
    def expire(self, later_ms: int) -> None:
        self.now_ms += later_ms
        for txid in self.pool.purge_expired(self.now_ms):
            assert self.model.pop(txid).body.valid_until_ms <= self.now_ms

    @rule(max_count=st.integers(1, 20), max_bytes=st.integers(200, 5_000), data=st.data())
    def take(self, max_count: int, max_bytes: int, data: st.DataObject) -> None:
        exclude = data.draw(st.sets(st.sampled_from(sorted(self.model)))) if self.model else set()
        taken = self.pool.take(max_count=max_count, max_bytes=max_bytes, timestamp_ms=self.now_ms, exclude=exclude)
        txids = [item.txid for item in taken]
        assert len(set(txids)) == len(txids) <= max_count
        assert sum(len(item.wire) for item in taken) <= max_bytes
        assert not exclude & set(txids)
        assert all(self.model[txid].body.valid_until_ms > self.now_ms for txid in txids)
        available = {
            txid for txid, item in self.model.items() if txid not in exclude and item.body.valid_until_ms > self.now_ms
        }
        if max_count >= len(available) and max_bytes >= POOL_MAX_BYTES:
            assert set(txids) == available

    @invariant()
    def accounts_are_right(self) -> None:
        waiting = self.pool.transactions()
        assert {item.txid for item in waiting} == set(self.model)
        assert self.pool.size_bytes == sum(len(item.wire) for item in waiting) <= POOL_MAX_BYTES
        ordinary = sum(len(item.wire) for item in waiting if item.body.contract == "records")
        assert self.pool.ordinary_bytes == ordinary <= POOL_MAX_BYTES - POOL_MAX_BYTES // 10

    @invariant()
    def everybody_pays_once_for_what_waits_or_left(self) -> None:
        for key, paid in self.paid.items():
            assert self.budgets.level(key) == BURST_BYTES - paid


TestPool = PoolMachine.TestCase
TestPool.settings = settings(stateful_step_count=40, suppress_health_check=list(HealthCheck))

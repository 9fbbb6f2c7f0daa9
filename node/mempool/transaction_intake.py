"""Fair, budgeted intake of transactions; signatures are checked last, in a thread.

Senders pay for what they signed; otherwise the source pays.
"""

from __future__ import annotations

import asyncio
from collections import Counter, OrderedDict, deque
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import NoReturn

import structlog

from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from contracts.execution.sender_admission import is_registration
from node.limits.token_buckets import OWN, Allowance, Charge, Source, SourceKind, TokenBuckets, over_budget
from node.limits.work_costs import EC_OPERATION_US, TRANSACTION_SCREENING_US
from node.mempool.mempool import Mempool, Screened
from node.mempool.transaction_pool import PoolStatus, SubmitResult, TransactionPool

SLICE_MAX_US = 2_000
INLINE_MAX_COUNT = 4
REGISTRATION_US = 3 * EC_OPERATION_US
SIGNED_US = EC_OPERATION_US + TRANSACTION_SCREENING_US
KNOWN_US = 5
UNSEEN_MAX_AGE_MS = 2_000
QUEUE_OF_PEER_MAX_BYTES = 4 * 1024 * 1024
QUEUE_OF_CLIENT_MAX_BYTES = 2 * 1024 * 1024
QUEUE_OF_VISIT_KEY_MAX_BYTES = 64 * 1024
"""What one of the visit keys at an address may have in their queue; a request alone may be larger if there is room. So much
of one that has nothing there is taken up to twice the limit, so that it takes 32 visits to have another one refused."""
QUEUES_MAX_COUNT = 512

PEER_ALLOWANCE = Allowance(us_per_s=100_000, burst_us=250_000)
ADDRESS_ALLOWANCE = Allowance(us_per_s=25_000, burst_us=250_000)
LOOPBACK_ALLOWANCE = Allowance(us_per_s=50_000, burst_us=250_000)
"""On an emulated network every client shares one address."""
SESSION_ALLOWANCE = Allowance(us_per_s=50_000, burst_us=250_000)
VISIT_KEYS_ALLOWANCE = Allowance(us_per_s=100_000, burst_us=500_000)
VISIT_KEY_ALLOWANCE = Allowance(us_per_s=2 * TRANSACTION_SCREENING_US, burst_us=8 * TRANSACTION_SCREENING_US)
"""What each of the visit keys at one address may have looked at when the others have used up what they share."""
SENDER_ALLOWANCE = Allowance(us_per_s=30_000, burst_us=60_000)
"""Some 160 transactions a second, whoever brings them to which node: each is looked at, checked and executed by all."""
ORIGIN_ALLOWANCE = Allowance(us_per_s=60_000, burst_us=120_000)
"""The same for all visits that one robot opened, some of which may be under keys of its own."""
TRIAL_ALLOWANCE = Allowance(us_per_s=2 * EC_OPERATION_US, burst_us=8 * EC_OPERATION_US)
"""What a sender may have checked behind an address that others used up."""

REFUSAL_GRID_S = 0.05
"""A client is told at the next such step that nobody admitted signed: checking a signature or not takes less."""

log = structlog.get_logger(__name__)

_UNSIGNED = frozenset({"SIGNATURE_INVALID", "SIGNATURE_HIGH_S"})
_NOT_ADMITTED = "SENDER_NOT_ADMITTED"
_OWN_FAULTS = frozenset({"SENDER_LIMIT", "RATE_LIMITED"})  # of whoever signed too much
_KNOW_MEMBERS = frozenset({"own", "peer"})  # sources to which it is no secret who is a member
_ALLOWANCES: dict[SourceKind, Allowance] = {
    "own": Allowance(us_per_s=1_000_000, burst_us=10_000_000),
    "peer": PEER_ALLOWANCE,
    "address": ADDRESS_ALLOWANCE,
    "loopback": LOOPBACK_ALLOWANCE,
    "session": SESSION_ALLOWANCE,
    "visit_keys": VISIT_KEYS_ALLOWANCE,
}


@dataclass(frozen=True, slots=True)
class Outcome:
    """One transaction's result; `transaction` is None if unread or malformed."""

    wire: bytes
    transaction: Transaction | None
    is_new: bool
    error: BlockRobotError | None


Sink = Callable[[list[Outcome]], None]
"""Hears what became of a slice of what was brought."""


@dataclass(slots=True)
class _Job:
    source: Source
    wires: deque[bytes]
    sink: Sink
    also: Callable[[Transaction], None] | None
    done: asyncio.Future[None] | None = None
    waiting_bytes: int = 0
    counted_bytes: int = 0
    """What its queue has counted of it."""
    refused_senders: dict[bytes, BlockRobotError] = field(default_factory=dict)
    """Senders over their budget: the rest of theirs in this job is refused without reading the ledger for it."""

    def __post_init__(self) -> None:
        self.waiting_bytes = sum(map(len, self.wires))

    def take(self) -> bytes:
        wire = self.wires.popleft()
        self.waiting_bytes -= len(wire)
        return wire

    def take_rest(self) -> list[bytes]:
        rest = list(self.wires)
        self.clear()
        return rest

    def clear(self) -> None:
        self.wires.clear()
        self.waiting_bytes = 0


@dataclass(slots=True)
class _Paid:
    """Payments by source and sender for one transaction; one is refunded."""

    item: Screened
    by_bringer: list[Charge]
    by_sender: list[Charge] = field(default_factory=list)


@dataclass(slots=True)
class _Queue:
    jobs: deque[_Job] = field(default_factory=deque)
    size_bytes: int = 0
    size_of_parts_bytes: Counter[str] = field(default_factory=Counter)

    def count(self, job: _Job) -> None:
        change_bytes, job.counted_bytes = job.waiting_bytes - job.counted_bytes, job.waiting_bytes
        self.size_bytes += change_bytes
        part = job.source.part
        if part:
            self.size_of_parts_bytes[part] += change_bytes
            if not self.size_of_parts_bytes[part]:
                del self.size_of_parts_bytes[part]


class TransactionIntake:
    """The one way into the mempool; on the event loop only."""

    def __init__(
        self,
        mempool: Mempool,
        clock: Callable[[], int],
        on_over_budget: Callable[[str, BlockRobotError], None] = lambda _source, _error: None,
    ) -> None:
        """`clock` gives ms since 1970; `on_over_budget` gets sources over their budget."""
        self._loop = asyncio.get_running_loop()
        self._mempool = mempool
        self._clock = clock
        self._on_over_budget = on_over_budget
        self._sources: TokenBuckets[Source] = TokenBuckets(lambda source: _ALLOWANCES[source.kind], self._loop.time)
        self._senders: TokenBuckets[str] = TokenBuckets(lambda _sender: SENDER_ALLOWANCE, self._loop.time)
        self._origins: TokenBuckets[str] = TokenBuckets(lambda _origin: ORIGIN_ALLOWANCE, self._loop.time)
        self._parts: TokenBuckets[Source] = TokenBuckets(lambda _part: VISIT_KEY_ALLOWANCE, self._loop.time)
        self._trials: TokenBuckets[tuple[Source, str]] = TokenBuckets(lambda _pair: TRIAL_ALLOWANCE, self._loop.time)
        self._rings: tuple[OrderedDict[Source, _Queue], ...] = (OrderedDict(), OrderedDict())
        self._turn = 0
        self._task: asyncio.Task[None] | None = None
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="signatures")
        self.signatures_checked_count = 0
        self.dropped_count = 0

    async def stop(self) -> None:
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)
        for ring in self._rings:
            for queue in ring.values():
                for job in queue.jobs:
                    if job.done is not None:
                        job.done.cancel()
            ring.clear()
        self._thread.shutdown(wait=True)

    # Bringing

    def offer(self, source: Source, wires: Sequence[bytes], sink: Sink) -> None:
        """Queue a peer's transactions; drop what exceeds its queue."""
        self._bring(_Job(source, deque(wires), sink, None))

    async def submit(
        self, source: Source, wires: Sequence[bytes], also: Callable[[Transaction], None], sink: Sink
    ) -> None:
        """Process a client's transactions; return when all are checked. Raises RATE_LIMITED beforehand."""
        if len(wires) > INLINE_MAX_COUNT and source != OWN:
            cost_us = len(wires) * TRANSACTION_SCREENING_US
            charge = self._sources.take(source.shared, cost_us)
            if charge is None:
                self._refuse(str(source), self._sources.wait_s(source.shared, cost_us))
            charge.give_back()  # paid for one by one as they are looked at
        began_s, is_refused = self._loop.time(), False

        def on_outcomes(outcomes: list[Outcome]) -> None:
            nonlocal is_refused
            is_refused = is_refused or any(one.error and one.error.code == _NOT_ADMITTED for one in outcomes)
            sink(outcomes)

        job = _Job(source, deque(wires), on_outcomes, also, done=self._loop.create_future())
        if not self._bring(job):
            raise over_budget(str(source), 1.0)
        if job.done is not None:
            await job.done
        if is_refused and source != OWN:
            await asyncio.sleep(REFUSAL_GRID_S - (self._loop.time() - began_s) % REFUSAL_GRID_S)

    def _bring(self, job: _Job) -> bool:
        is_idle = self._task is None or self._task.done()
        if is_idle and len(job.wires) <= INLINE_MAX_COUNT:
            screened, outcomes = self._screen_slice(job)
            outcomes += [self._settle(job.source, paid, _check(paid.item)) for paid in screened]
            if not job.wires:
                job.sink(outcomes)
                _finish(job)
                return True
            job.sink(outcomes)
        ring = self._rings[job.source.kind not in {"own", "peer"}]
        limit = QUEUE_OF_PEER_MAX_BYTES if job.source.kind in {"own", "peer"} else QUEUE_OF_CLIENT_MAX_BYTES
        queue = ring.get(job.source.shared)
        if not _has_place(queue, job.source, job.waiting_bytes, limit) or (
            queue is None and len(ring) >= QUEUES_MAX_COUNT
        ):
            self.dropped_count += len(job.wires)
            self._on_over_budget(str(job.source), over_budget(str(job.source), 1.0))
            return False
        if queue is None:
            queue = ring[job.source.shared] = _Queue()
        queue.jobs.append(job)
        queue.count(job)
        if is_idle:
            self._task = self._loop.create_task(self._work(), name="intake")
        return True

    def note_unseen(self, block_time_ms: int, transactions: Sequence[Transaction]) -> None:
        """Charge senders for transactions of a final block that other nodes admitted.

        Otherwise each node would admit a full budget of its own. Old blocks, seen while catching up, charge nobody.
        """
        if self._clock() - block_time_ms > UNSEEN_MAX_AGE_MS:
            return
        counts = Counter(transaction.body.sender for transaction in transactions)
        for transaction in {transaction.body.sender: transaction for transaction in transactions}.values():
            sender = transaction.body.sender
            account, cost_us = self._mempool.account_of(transaction), counts[sender] * SIGNED_US
            self._senders.charge(account.name_payer(sender), cost_us, SENDER_ALLOWANCE.burst_us)
            if account.origin:
                self._origins.charge(account.origin, cost_us, ORIGIN_ALLOWANCE.burst_us)

    def forget(self, source: Source) -> None:
        for ring in self._rings:
            queue = ring.pop(source, None)
            for job in () if queue is None else queue.jobs:
                job.clear()
                _finish(job)

    # Working

    async def _work(self) -> None:
        while True:
            ring = self._rings[self._turn] or self._rings[1 - self._turn]
            self._turn = 1 - self._turn
            if not ring:
                return
            source, queue = next(iter(ring.items()))
            job = queue.jobs[0]
            try:
                await self._take_slice(source, queue, job)
            except Exception as fault:
                log.exception("intake_fault", source=str(source))
                job.clear()
                queue.count(job)
                if job.done is not None and not job.done.done():
                    job.done.set_exception(fault)
            if not job.wires:
                _finish(job)
                queue.jobs.popleft()
            if ring.get(source) is queue:
                ring.move_to_end(source)
                if not queue.jobs:
                    del ring[source]
            await asyncio.sleep(0)

    async def _take_slice(self, source: Source, queue: _Queue, job: _Job) -> None:
        screened, outcomes = self._screen_slice(job)
        queue.count(job)
        if len(screened) <= INLINE_MAX_COUNT:
            checked = [_check(paid.item) for paid in screened]
        else:
            checked = await self._loop.run_in_executor(self._thread, _check_all, [paid.item for paid in screened])
        outcomes += [self._settle(source, paid, error) for paid, error in zip(screened, checked, strict=True)]
        job.sink(outcomes)

    def _screen_slice(self, job: _Job) -> tuple[list[_Paid], list[Outcome]]:
        now_ms, weight_us = self._clock(), 0
        screened: list[_Paid] = []
        outcomes: list[Outcome] = []
        while job.wires and weight_us < SLICE_MAX_US:
            weight_us += TRANSACTION_SCREENING_US
            try:
                charge = self._pay(job.source, TRANSACTION_SCREENING_US)
            except BlockRobotError as error:
                # Together: nobody pays for refusals, and one by one they took more CPU than the whole budget.
                self.dropped_count += len(job.wires) - 1  # one is counted already
                outcomes += [Outcome(wire, None, is_new=False, error=error) for wire in job.take_rest()]
                break
            wire, transaction = job.take(), None
            try:
                transaction, is_verified = self._mempool.read(wire)
                refusal = None if is_verified else job.refused_senders.get(transaction.body.sender)
                if refusal is not None:
                    self.dropped_count += 1
                    outcomes.append(Outcome(wire, transaction, is_new=False, error=refusal))
                    continue
                paid, cost_us = self._screen(job, charge, transaction, now_ms, is_verified=is_verified)
            except BlockRobotError as error:
                outcomes.append(Outcome(wire, transaction, is_new=False, error=error))
                continue
            weight_us += cost_us
            if paid.item.is_verified:
                outcomes.append(self._settle(job.source, paid, None))
            else:
                screened.append(paid)
        return screened, outcomes

    def _screen(
        self, job: _Job, charge: Charge, transaction: Transaction, now_ms: int, *, is_verified: bool
    ) -> tuple[_Paid, int]:
        """Raises RATE_LIMITED."""
        source, cost_us, receipts = job.source, 0, [charge]
        if is_registration(transaction) and not is_verified:
            cost_us = REGISTRATION_US
            receipts.append(self._pay(source, cost_us))
        try:
            item = self._mempool.screen(transaction, now_ms, job.also, is_verified=is_verified)
        except BlockRobotError as error:
            if error.code == _NOT_ADMITTED and source.kind not in _KNOW_MEMBERS and not cost_us:
                # so that no stranger is told from a member
                self._pay_for_signature(source, f"key {transaction.body.sender.hex()}")
            raise
        paid = _Paid(item, receipts)
        if item.is_waiting:
            charge.give_back(TRANSACTION_SCREENING_US - KNOWN_US)
        elif not is_verified and not cost_us:
            cost_us = EC_OPERATION_US
            if source != OWN:
                try:
                    paid.by_sender = self._pay_as_sender(item)
                except BlockRobotError as error:
                    job.refused_senders[transaction.body.sender] = error
                    raise
                try:
                    receipts.append(self._pay_for_signature(source, item.account.name_payer(transaction.body.sender)))
                except BlockRobotError:
                    _give_back(paid.by_sender)
                    raise
        return paid, cost_us

    def _pay(self, source: Source, cost_us: int) -> Charge:
        charge = self._sources.take(source.shared, cost_us)
        if charge is None and source.part:
            charge = self._parts.take(source, cost_us)
        return charge or self._refuse(str(source), self._sources.wait_s(source.shared, cost_us))

    def _pay_as_sender(self, item: Screened) -> list[Charge]:
        account = item.account
        payer = account.name_payer(item.transaction.body.sender)
        charges: list[Charge] = []
        for buckets, name in ((self._senders, payer), (self._origins, account.origin)):
            charge = buckets.take(name, SIGNED_US) if name else None
            if charge is not None:
                charges.append(charge)
            elif name:
                _give_back(charges)
                self._refuse(payer, buckets.wait_s(name, SIGNED_US))
        return charges

    def _pay_for_signature(self, source: Source, sender: str) -> Charge:
        """Charge the source, or the sender's small budget behind an exhausted address."""
        source = source.shared
        charge = self._sources.take(source, EC_OPERATION_US)
        if charge is None and source.kind != "peer":
            charge = self._trials.take((source, sender), EC_OPERATION_US)
        return charge or self._refuse(str(source), self._sources.wait_s(source, EC_OPERATION_US))

    def _refuse(self, who: str, wait_s: float) -> NoReturn:
        self.dropped_count += 1
        error = over_budget(who, wait_s)
        self._on_over_budget(who, error)
        raise error

    def _settle(self, source: Source, paid: _Paid, error: BlockRobotError | None) -> Outcome:
        item, is_signed = paid.item, error is None
        transaction = item.transaction
        if not item.is_verified:
            self.signatures_checked_count += 1
            if is_signed:
                for charge in paid.by_bringer:
                    charge.give_back()
            else:
                _give_back(paid.by_sender)
        is_new = False
        if is_signed:
            try:
                _, is_new = self._mempool.insert(item)
            except BlockRobotError as refusal:
                error = refusal
                if refusal.code in _OWN_FAULTS and source != OWN:
                    self._on_over_budget(item.account.name, refusal)
        if error is not None and source.kind not in _KNOW_MEMBERS:
            error = redact_for_clients(error)
        return Outcome(transaction.wire, transaction, is_new, error)


def redact_for_clients(error: BlockRobotError) -> BlockRobotError:
    """Return the client's error: without a signature, equal for members and strangers."""
    return BlockRobotError(_NOT_ADMITTED) if error.code in _UNSIGNED else error


def _give_back(charges: list[Charge]) -> None:
    for charge in charges:
        charge.give_back()


def _check(item: Screened) -> BlockRobotError | None:
    try:
        item.transaction.verify_sender()
    except BlockRobotError as error:
        return error
    return None


def _check_all(items: list[Screened]) -> list[BlockRobotError | None]:
    return [_check(item) for item in items]


def _has_place(queue: _Queue | None, source: Source, size_bytes: int, limit_bytes: int) -> bool:
    waiting_bytes = 0 if queue is None else queue.size_bytes
    if queue is not None and source.part:
        own_bytes = queue.size_of_parts_bytes[source.part]
        if own_bytes + size_bytes <= QUEUE_OF_VISIT_KEY_MAX_BYTES:
            limit_bytes *= 1 if own_bytes else 2
        elif own_bytes:
            return False
    return waiting_bytes + size_bytes <= limit_bytes


def _finish(job: _Job) -> None:
    if job.done is not None and not job.done.done():
        job.done.set_result(None)


class ClientPool:
    """A pool, closed while the node has a problem with all its peers."""

    def __init__(self, pool: TransactionPool, problem: Callable[[], BlockRobotError | None]) -> None:
        """`problem` returns why all peers reject this node, or None."""
        self._pool = pool
        self._problem = problem

    async def submit(self, wires: Sequence[bytes], source: Source = OWN) -> Sequence[SubmitResult]:
        """As `TransactionPool.submit`. Raises NODE_REMOVED, CERTIFICATE_EXPIRED, CERTIFICATE_REVOKED."""
        problem = self._problem()
        if problem is not None:
            raise problem
        return await self._pool.submit(wires, source)

    def status(self, txid: bytes) -> PoolStatus:
        return self._pool.status(txid)

    async def wait_final(self, txid: bytes, timeout_ms: int) -> bool:
        return await self._pool.wait_final(txid, timeout_ms)

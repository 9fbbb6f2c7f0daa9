"""Transactions come in for their source's budget: cheap checks first, signatures last, and everybody in turn."""

from __future__ import annotations

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Any, get_args

import pytest

import consensus.chain.transaction
import contracts.execution.sender_admission
from consensus.chain.transaction import Transaction, TransactionWire
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode
from consensus.primitives.keys import recover
from contracts.execution.sender_admission import Account, find_admission_error, name_grantees
from node.limits.account_byte_limiter import AccountByteLimiter
from node.limits.token_buckets import Source, SourceKind
from node.limits.work_costs import EC_OPERATION_US, TRANSACTION_SCREENING_US
from node.mempool.mempool import Mempool
from node.mempool.transaction_intake import (
    LOOPBACK_ALLOWANCE,
    ORIGIN_ALLOWANCE,
    PEER_ALLOWANCE,
    SENDER_ALLOWANCE,
    SIGNED_US,
    UNSEEN_MAX_AGE_MS,
    Outcome,
    TransactionIntake,
)
from tests.unit.node.mempool.pool_setup import NOW_MS, make_pool, sender, transaction
from tests.virtual_time import in_virtual_time

STRANGER = Source("loopback", "127.0.0.1")
OTHER = Source("loopback", "127.0.0.2")
VISIT = Source("visit_keys", "192.0.2.1", "quiet")


class _Counter:
    """Counts the recoveries of keys, wherever they are done."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.count = 0
        for module in (consensus.chain.transaction, contracts.execution.sender_admission):
            monkeypatch.setattr(module, "recover", self._recover)
        contracts.execution.sender_admission._recovers.cache_clear()

    def _recover(self, *arguments: Any) -> bytes:
        self.count += 1
        return recover(*arguments)


@pytest.fixture
def counter(monkeypatch: pytest.MonkeyPatch) -> _Counter:
    return _Counter(monkeypatch)


class _Empty:
    """A state in which nobody is anything."""

    def get(self, _key: bytes) -> bytes | None:
        return None


def _stands(item: Transaction) -> bool:
    """As a node has it: raises why a sender has no standing."""
    fault = find_admission_error(_Empty(), item, NOW_MS)  # type: ignore[arg-type] - only read by key
    if fault:
        raise BlockRobotError(fault)
    return True


def forged(number: int, by: int = 0) -> bytes:
    """A transaction that this sender is said to have signed."""
    mine = transaction(number, by=by)
    return encode(TransactionWire(body=mine.body_bytes, signature=transaction(number + 1, by=by + 1).signature))


@in_virtual_time
async def _run(
    pool: Mempool, story: Callable[[TransactionIntake], Awaitable[None]], over: list[str] | None = None
) -> None:
    named = [] if over is None else over
    intake = TransactionIntake(pool, lambda: NOW_MS, lambda source, _error: named.append(source))
    await story(intake)
    await intake.stop()


async def _submit(intake: TransactionIntake, source: Source, wires: list[bytes]) -> list[Outcome]:
    found: list[Outcome] = []
    try:
        await intake.submit(source, wires, lambda _item: None, found.extend)
    except BlockRobotError as error:
        return [Outcome(b"", None, is_new=False, error=error)]
    return found


def _codes(outcomes: list[Outcome]) -> set[str]:
    return {"" if outcome.error is None else outcome.error.code for outcome in outcomes}


def test_a_batch_of_foreign_transactions_costs_no_elliptic_curve_operation(counter: _Counter) -> None:
    async def story(intake: TransactionIntake) -> None:
        wires = [transaction(number, by=number).wire for number in range(256)]
        assert _codes(await _submit(intake, STRANGER, wires)) == {"SENDER_NOT_ADMITTED"}
        assert counter.count == 0

    _run(make_pool(check_admission=_stands), story)


def test_a_false_registration_costs_one_operation_and_its_source_pays(counter: _Counter) -> None:
    def registration(number: int) -> bytes:
        texts = [bytes([number]) * 32, b"card", "subject", NOW_MS + 1, bytes(65), b"", b"", b"", bytes(65), []]
        return transaction(number, contract="identity", entry="register", arguments=texts).wire

    async def story(intake: TransactionIntake) -> None:
        outcomes = await _submit(intake, STRANGER, [registration(number) for number in range(200)])
        assert _codes(outcomes) <= {"VOUCHER_FOREIGN", "RATE_LIMITED"}
        assert counter.count <= 200

    over: list[str] = []
    _run(make_pool(check_admission=_stands), story, over)
    burst = LOOPBACK_ALLOWANCE.burst_us // (3 * EC_OPERATION_US)
    assert 1 <= counter.count <= burst + 1


def test_false_signatures_in_a_members_name_are_checked_only_within_the_budget_of_who_brings_them(
    counter: _Counter,
) -> None:
    over: list[str] = []
    batch = [forged(number) for number in range(200)]
    counter.count = 0

    async def repeated(intake: TransactionIntake) -> None:
        for _ in range(100):
            await _submit(intake, STRANGER, batch)

    _run(make_pool(), repeated, over)
    assert counter.count <= LOOPBACK_ALLOWANCE.burst_us / EC_OPERATION_US + 10
    assert set(over) == {str(STRANGER)}


def test_who_fills_their_part_of_the_pool_is_named_and_nobody_in_whose_name_it_is_tried() -> None:
    over: list[str] = []

    async def story(intake: TransactionIntake) -> None:
        await _submit(intake, STRANGER, [transaction(number).wire for number in range(3)])
        await _submit(intake, STRANGER, [forged(10)])
        assert over == []
        assert _codes(await _submit(intake, STRANGER, [transaction(3).wire])) == {"SENDER_LIMIT"}

    _run(make_pool(sender_max_count=3), story, over)
    assert over == [f"key {sender(0).public_key.hex()}"]


def test_who_comes_last_to_a_shared_part_is_not_named_for_what_others_filled() -> None:
    over: list[str] = []
    shared = Account(name_grantees(b"\x02" * 33), is_of_visit=True, origin="visits of a robot", is_shared=True)

    async def story(intake: TransactionIntake) -> None:
        for by in range(16):
            await _submit(intake, STRANGER, [transaction(number, by=by).wire for number in range(4)])
        assert _codes(await _submit(intake, STRANGER, [transaction(0, by=99).wire])) == {"SENDER_LIMIT"}

    _run(make_pool(sender_max_count=64, account_of=lambda _: shared), story, over)
    assert over == [f"grantees of visit {'02' * 33}"]


def test_many_visits_of_one_robot_have_no_more_than_twice_the_budget_of_one() -> None:
    over: list[str] = []

    def account_of(item: Transaction) -> Account:
        return Account(f"visit {item.body.sender.hex()}", is_of_visit=True, origin="visits of a robot")

    async def story(intake: TransactionIntake) -> None:
        for by in range(6):
            wires = [transaction(number, by=by).wire for number in range(1_000)]
            for first in range(0, len(wires), 200):
                await _submit(intake, Source("loopback", f"127.0.{by}.{first // 200}"), wires[first : first + 200])

    pool = make_pool(sender_max_count=100_000, account_of=account_of)
    _run(pool, story, over)
    assert SENDER_ALLOWANCE.burst_us / SIGNED_US < len(pool) <= ORIGIN_ALLOWANCE.burst_us / SIGNED_US + 10
    assert {who.partition(" ")[0] for who in over} == {"visit"}


@pytest.mark.parametrize(("age_ms", "codes"), [(0, {"RATE_LIMITED"}), (UNSEEN_MAX_AGE_MS + 1, {""})])
def test_a_sender_pays_here_too_for_what_other_nodes_let_in(age_ms: int, codes: set[str]) -> None:
    """All nodes together let in no more than one would; who only catches up with old blocks charges nobody."""
    let_in = [transaction(number) for number in range(SENDER_ALLOWANCE.burst_us // SIGNED_US + 1)]

    async def story(intake: TransactionIntake) -> None:
        intake.note_unseen(NOW_MS - age_ms, let_in)
        assert _codes(await _submit(intake, STRANGER, [transaction(90_000).wire])) == codes
        assert _codes(await _submit(intake, STRANGER, [transaction(90_000, by=3).wire])) == {""}

    _run(make_pool(), story)


@in_virtual_time
async def test_nobody_is_refused_for_long_after_what_others_let_in() -> None:
    intake = TransactionIntake(make_pool(sender_max_count=100_000), lambda: NOW_MS)
    for first in range(0, 5_000, 500):
        intake.note_unseen(NOW_MS, [transaction(number) for number in range(first, first + 500)])
    await asyncio.sleep(SENDER_ALLOWANCE.burst_us / SENDER_ALLOWANCE.us_per_s + 0.1)
    assert _codes(await _submit(intake, STRANGER, [transaction(90_000).wire])) == {""}
    await intake.stop()


def test_who_uses_up_their_bytes_is_named() -> None:
    over: list[str] = []
    limiter = AccountByteLimiter(bytes_per_s=1, burst_bytes=3 * len(transaction(0).wire))

    async def story(intake: TransactionIntake) -> None:
        assert _codes(await _submit(intake, STRANGER, [transaction(number).wire for number in range(4)])) == {
            "",
            "RATE_LIMITED",
        }

    _run(make_pool(byte_budgets=limiter), story, over)
    assert over == [f"key {sender(0).public_key.hex()}"]


def test_a_member_whose_name_is_abused_is_not_charged_and_goes_on_elsewhere() -> None:
    async def story(intake: TransactionIntake) -> None:
        batch = [forged(number) for number in range(200)]
        for _ in range(60):
            await _submit(intake, STRANGER, batch)
        wires = [transaction(number).wire for number in range(1_000, 1_200)]
        assert _codes(await _submit(intake, OTHER, wires)) == {""}

    _run(make_pool(), story)


def test_behind_an_address_that_others_used_up_a_member_still_gets_a_few_transactions_through() -> None:
    async def story(intake: TransactionIntake) -> None:
        noise = [transaction(number, by=7, valid_until_ms=NOW_MS).wire for number in range(200)]
        batch = [forged(number, by=7) for number in range(200)]
        for _ in range(80):
            await _submit(intake, STRANGER, batch)
        assert "RATE_LIMITED" in _codes(await _submit(intake, STRANGER, noise))
        await asyncio.sleep(0.001)
        assert _codes(await _submit(intake, STRANGER, [transaction(9_000, by=3).wire])) == {""}

    _run(make_pool(), story)


def test_a_visit_that_floods_leaves_the_others_at_its_address_a_few_transactions() -> None:
    """All patients of a hospital may stand behind one address."""

    async def story(intake: TransactionIntake) -> None:
        loud, quiet = (Source("visit_keys", "192.0.2.1", part) for part in ("loud", "quiet"))
        noise = [transaction(number, by=7, valid_until_ms=NOW_MS).wire for number in range(200)]
        for _ in range(200):
            if _codes(await _submit(intake, loud, noise)) == {"RATE_LIMITED"}:
                break
        else:
            raise AssertionError("there is no bound")
        assert _codes(await _submit(intake, quiet, [transaction(9_000, by=3).wire])) == {""}

    _run(make_pool(), story)


@pytest.mark.parametrize(("source", "left_s"), [(STRANGER, 0.004), (VISIT, 0.001), (VISIT, 0.0)])
def test_what_a_reserve_paid_for_a_signed_transaction_does_not_go_to_the_address(source: Source, left_s: float) -> None:
    def looked_at(*wires: bytes) -> int:
        """Return how many expired transactions a used-up address has looked at after these."""
        count = 0

        async def story(intake: TransactionIntake) -> None:
            nonlocal count
            noise = [transaction(number, by=7, valid_until_ms=NOW_MS).wire for number in range(8)]
            loud = replace(source, part="loud") if source.part else source
            while "RATE_LIMITED" not in _codes(await _submit(intake, loud, noise[:1])):
                pass
            await asyncio.sleep(left_s)
            assert all(outcome.is_new == bool(wires) for outcome in await _submit(intake, source, list(wires)))
            for one in noise:
                count += "RATE_LIMITED" not in _codes(await _submit(intake, loud, [one]))

        _run(make_pool(), story)
        return count

    assert looked_at(transaction(9_000, by=3).wire) <= looked_at()


@pytest.mark.parametrize("visits_count", [1, 40])
def test_visits_that_flood_leave_the_others_at_their_address_room_in_their_queue(visits_count: int) -> None:
    async def story(intake: TransactionIntake) -> None:
        batch = [transaction(number, by=number).wire for number in range(400)]
        flood = [
            asyncio.ensure_future(_submit(intake, Source("visit_keys", "192.0.2.1", str(n % visits_count)), batch))
            for n in range(40)
        ]
        await asyncio.sleep(0)
        late = await _submit(intake, Source("visit_keys", "192.0.2.1", "quiet"), batch[:300])
        assert all(outcome.transaction is not None for outcome in late)
        refused = [outcomes for outcomes in await asyncio.gather(*flood) if len(outcomes) == 1]
        assert refused, "there is a bound"

    _run(make_pool(), story)


def test_signed_transactions_are_paid_by_their_sender_and_not_by_the_address(counter: _Counter) -> None:
    async def story(intake: TransactionIntake) -> None:
        for by in range(5):
            wires = [transaction(by * 1_000 + number, by=by).wire for number in range(200)]
            assert _codes(await _submit(intake, STRANGER, wires)) == {""}

    _run(make_pool(), story)
    assert counter.count == 5 * 200


def test_one_member_is_held_to_his_own_budget_wherever_he_sends_from() -> None:
    async def story(intake: TransactionIntake) -> None:
        codes: set[str] = set()
        for place in range(12):
            wires = [transaction(place * 1_000 + number).wire for number in range(200)]
            codes |= _codes(await _submit(intake, Source("loopback", f"127.0.0.{place}"), wires))
        assert codes == {"", "RATE_LIMITED"}

    over: list[str] = []
    _run(make_pool(sender_max_count=100_000), story, over)
    assert set(over) == {f"key {sender(0).public_key.hex()}"}


def test_a_loud_source_holds_nobody_up_for_more_than_a_few_slices() -> None:
    async def story(intake: TransactionIntake) -> None:
        loud = [transaction(number, by=number % 50).wire for number in range(1_000)]
        order: list[str] = []
        intake.offer(Source("peer", "loud"), loud, lambda outcomes: order.extend(["loud"] * len(outcomes)))
        wires = [transaction(90_000 + number, by=99).wire for number in range(8)]
        await intake.submit(OTHER, wires, lambda _item: None, lambda found: order.extend(["quiet"] * len(found)))
        assert order.count("quiet") == 8
        assert len(order) < 200

    _run(make_pool(), story)


def test_what_is_beyond_a_peers_queue_is_dropped_and_the_peer_named() -> None:
    async def story(intake: TransactionIntake) -> None:
        batch = [transaction(number, by=number % 50).wire for number in range(500)]
        for _ in range(80):
            intake.offer(Source("peer", "loud"), batch, lambda _outcomes: None)
        assert intake.dropped_count > 0

    over: list[str] = []
    _run(make_pool(), story, over)
    assert set(over) == {"peer loud"}


def test_a_peer_pays_for_what_nobody_signed() -> None:
    async def story(intake: TransactionIntake) -> None:
        found: list[Outcome] = []
        batch = [transaction(number, by=number).wire for number in range(500)]
        for _ in range(40):
            intake.offer(Source("peer", "loud"), batch, found.extend)
            await asyncio.sleep(0.001)
        await asyncio.sleep(0.1)
        seen = sum(outcome.error is not None and outcome.error.code == "SENDER_NOT_ADMITTED" for outcome in found)
        assert seen > 0, "what there was budget for was judged"
        assert seen * TRANSACTION_SCREENING_US <= PEER_ALLOWANCE.burst_us + PEER_ALLOWANCE.us_per_s * 0.3

    _run(make_pool(check_admission=_stands), story)


def test_the_ledger_is_not_read_for_the_rest_of_whoever_is_over_budget() -> None:
    """A refusal costs more than the signature that it saves, if everything is looked up for it first."""
    looked_up = 0

    def admit(_item: Transaction) -> bool:
        nonlocal looked_up
        looked_up += 1
        return True

    found: list[Outcome] = []

    async def story(intake: TransactionIntake) -> None:
        peer = Source("peer", "loud")
        for wires in ([transaction(number).wire for number in range(1_000)], [transaction(9_000, by=3).wire]):
            await intake.submit(peer, wires, lambda _item: None, found.extend)
        assert intake.dropped_count == sum(outcome.error is not None for outcome in found)

    _run(make_pool(check_admission=admit), story)
    codes = Counter("" if outcome.error is None else outcome.error.code for outcome in found)
    assert set(codes) == {"", "RATE_LIMITED"}
    assert looked_up == codes[""] + 1, "one refused, and the others like it"
    assert found[-1].error is None, "others of the same peer are heard"


def test_the_rest_of_a_message_is_refused_at_once_where_its_source_is_over_budget() -> None:
    over: list[str] = []
    found: list[Outcome] = []

    async def story(intake: TransactionIntake) -> None:
        batch = [transaction(number, by=number).wire for number in range(400)]
        while all(outcome.transaction is not None for outcome in found):
            intake.offer(Source("peer", "loud"), batch, found.extend)
            await asyncio.sleep(0.001)
        assert len(over) == 1, "one refusal, however many transactions the message has left"
        unread = [outcome for outcome in found if outcome.transaction is None]
        assert len(unread) > 1
        assert intake.dropped_count == len(unread)

    _run(make_pool(check_admission=_stands), story, over)


def test_a_fault_in_a_request_whose_client_has_left_stops_nobody_else() -> None:
    left: list[asyncio.Task[Any]] = []

    def broken(item: Transaction) -> bool:
        if item.body.sender == sender(5).public_key:
            left[0].cancel()
            raise ZeroDivisionError
        return True

    async def story(intake: TransactionIntake) -> None:
        left.append(asyncio.ensure_future(_submit(intake, STRANGER, [transaction(1, by=5).wire])))
        await asyncio.sleep(0)
        async with asyncio.timeout(10):
            assert _codes(await _submit(intake, OTHER, [transaction(number).wire for number in range(8)])) == {""}

    _run(make_pool(check_admission=broken), story)


def test_a_fault_of_the_node_itself_ends_one_request_and_no_other() -> None:
    def broken(item: Transaction) -> bool:
        if item.body.sender == sender(5).public_key:
            raise ZeroDivisionError
        return True

    async def story(intake: TransactionIntake) -> None:
        with pytest.raises(ZeroDivisionError):
            await _submit(intake, STRANGER, [transaction(number, by=5).wire for number in range(8)])
        assert _codes(await _submit(intake, OTHER, [transaction(number).wire for number in range(8)])) == {""}

    _run(make_pool(check_admission=broken), story)


def test_a_queue_counts_what_waits_in_it_also_after_a_fault_and_knows_no_part_of_which_nothing_waits() -> None:
    def broken(item: Transaction) -> bool:
        if item.body.sender == sender(5).public_key:
            raise ZeroDivisionError
        return True

    async def story(intake: TransactionIntake) -> None:
        for part, by in (("early", 6), ("faulty", 5), ("late", 7)):
            wires = [transaction(number, by=by).wire for number in range(60)]
            intake.offer(Source("visit_keys", "192.0.2.1", part), wires, lambda _outcomes: None)
        seen: set[tuple[str, ...]] = set()
        while queues := [queue for ring in intake._rings for queue in ring.values()]:
            (queue,) = queues
            waiting: Counter[str] = Counter()
            for job in queue.jobs:
                waiting[job.source.part] += sum(map(len, job.wires))
            assert (queue.size_bytes, dict(queue.size_of_parts_bytes)) == (waiting.total(), dict(+waiting))
            seen.add(tuple(waiting))
            await asyncio.sleep(0)
        assert ("late",) in seen, "the fault's part is gone, and something waited still"

    _run(make_pool(check_admission=broken), story)


def test_a_peer_that_is_gone_is_forgotten_with_all_that_waits_of_it() -> None:
    async def story(intake: TransactionIntake) -> None:
        found: list[Outcome] = []
        peer = Source("peer", "gone")
        intake.offer(peer, [transaction(number, by=number % 50).wire for number in range(500)], found.extend)
        intake.forget(peer)
        await asyncio.sleep(1)
        assert len(found) < 100

    _run(make_pool(), story)


@pytest.mark.parametrize("kind", get_args(SourceKind))
def test_every_kind_of_source_has_a_budget(kind: SourceKind) -> None:
    async def story(intake: TransactionIntake) -> None:
        (outcome,) = await _submit(intake, Source(kind, "somebody"), [transaction(1).wire])
        assert outcome.is_new

    _run(make_pool(), story)

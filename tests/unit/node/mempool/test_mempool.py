"""The pool lets in what may stand in a block, keeps everybody's turn, and stays within its bounds."""

from __future__ import annotations

from contextlib import suppress

import pytest

from consensus.chain.transaction import Transaction, TransactionWire
from consensus.errors import BlockRobotError
from consensus.limits import BLOCK_SIZE_MAX_BYTES, TRANSACTION_LIFETIME_MAX_MS, TRANSACTION_SIZE_MAX_BYTES
from consensus.primitives.encoding import encode
from consensus.primitives.keys import GROUP_ORDER
from consensus.state.layout import RESERVED_CALLS, RESERVED_CONTRACTS
from contracts.execution.sender_admission import Account
from contracts.lifecycle.registry import load_contracts
from node.limits.account_byte_limiter import ACCOUNT_BYTES_PER_S, AccountByteLimiter
from node.mempool.mempool import BLOCK_SHARE_COUNT, BLOCK_SHARE_OF_ORIGIN_COUNT, Mempool
from node.mempool.transaction_cache import TransactionCache
from tests.unit.node.mempool.pool_setup import NOW_MS, make_pool, sender, take_all, transaction


def _refusal(wire: bytes, **changes: object) -> str:
    pool = make_pool(**changes)
    with pytest.raises(BlockRobotError) as caught:
        pool.admit(wire, NOW_MS)
    assert len(pool) == 0
    assert pool.size_bytes == 0
    return caught.value.code


def test_room_is_reserved_only_for_contracts_and_calls_that_there_are() -> None:
    contracts = load_contracts()
    assert contracts.keys() >= RESERVED_CONTRACTS
    for contract, name in RESERVED_CALLS:
        assert contract not in RESERVED_CONTRACTS
        entry = contracts[contract].abi.entry(name)
        assert entry is not None
        assert entry.kind == "export"


def test_a_good_transaction_waits_and_is_known_when_it_comes_again() -> None:
    pool, wanted = make_pool(), transaction(1)
    assert pool.admit(wanted.wire, NOW_MS) == (wanted, True)
    assert pool.admit(wanted.wire, NOW_MS) == (wanted, False)
    assert wanted.txid in pool
    assert take_all(pool) == [wanted]


def test_what_is_no_transaction_in_its_one_form_is_refused() -> None:
    assert _refusal(transaction(1).wire[:-1]) == "ENCODING_INVALID"
    wire = encode(TransactionWire(body=bytes(TRANSACTION_SIZE_MAX_BYTES), signature=bytes(65)))
    assert _refusal(wire) == "TRANSACTION_TOO_LARGE"
    wire = transaction(1).wire
    assert wire[1] == 0xC4
    longer_length = wire[:1] + b"\xc5\x00" + wire[2:]
    assert _refusal(longer_length) == "ENCODING_NOT_CANONICAL"


def test_a_transaction_of_another_chain_or_time_or_known_already_is_refused() -> None:
    assert _refusal(transaction(1, chain_id=bytes(32)).wire) == "TRANSACTION_WRONG_CHAIN"
    assert _refusal(transaction(1, valid_until_ms=NOW_MS).wire) == "TRANSACTION_EXPIRED"
    late = NOW_MS + TRANSACTION_LIFETIME_MAX_MS + 1
    assert _refusal(transaction(1, valid_until_ms=late).wire) == "TRANSACTION_TOO_FAR_AHEAD"
    spent = transaction(1)
    assert _refusal(spent.wire, is_spent=lambda txid: txid == spent.txid) == "TRANSACTION_REPLAYED"


def test_a_signature_by_somebody_else_or_with_a_high_s_is_refused() -> None:
    mine = transaction(1)
    forged = TransactionWire(body=mine.body_bytes, signature=transaction(2, by=1).signature)
    assert _refusal(encode(forged)) == "SIGNATURE_INVALID"
    mine = transaction(1)
    s = GROUP_ORDER - int.from_bytes(mine.signature[32:64], "big")
    high = mine.signature[:32] + s.to_bytes(32, "big") + bytes([mine.signature[64] ^ 1])
    assert _refusal(encode(TransactionWire(body=mine.body_bytes, signature=high))) == "SIGNATURE_HIGH_S"


def test_a_sender_without_standing_is_refused_and_asked_about_again_next_time() -> None:
    members: set[bytes] = set()
    pool, wanted = make_pool(check_admission=lambda item: item.body.sender in members), transaction(1)
    with pytest.raises(BlockRobotError, match=r"^SENDER_NOT_ADMITTED:"):
        pool.admit(wanted.wire, NOW_MS)
    members.add(sender(0).public_key)
    assert pool.admit(wanted.wire, NOW_MS)[1]


def test_a_known_signature_is_not_checked_again_but_another_one_over_the_same_body_is() -> None:
    cache, mine = TransactionCache(), transaction(1)
    cache.add(mine)
    assert cache.verified(mine.wire) is mine
    other = TransactionWire(body=mine.body_bytes, signature=transaction(2, by=1).signature)
    with pytest.raises(BlockRobotError):
        cache.verified(encode(other))


def test_one_sender_cannot_fill_the_pool_and_that_is_told_to_nobody_who_did_not_sign() -> None:
    pool = make_pool(sender_max_count=3)
    for number in range(3):
        pool.admit(transaction(number).wire, NOW_MS)
    with pytest.raises(BlockRobotError, match=r"^SENDER_LIMIT:"):
        pool.admit(transaction(3).wire, NOW_MS)
    assert pool.admit(transaction(3, by=1).wire, NOW_MS)[1]
    pool = make_pool(sender_max_count=3)
    for number in range(3):
        pool.admit(transaction(number).wire, NOW_MS)
    screened = pool.screen(transaction(3), NOW_MS, is_verified=False)
    assert screened.refusal is not None
    assert screened.refusal.code == "SENDER_LIMIT"


def _shared(pool_fields: dict[str, int]) -> Mempool:
    """A pool in which all but sender 0 are grantees of one visit."""
    own = sender(0).public_key
    return make_pool(
        account_of=lambda item: Account(
            "own" if item.body.sender == own else "grantees", is_shared=item.body.sender != own
        ),
        **pool_fields,
    )


def test_a_visit_with_many_grantees_takes_no_more_turns_and_no_more_room_than_one_sender() -> None:
    pool = _shared({"sender_max_count": 32})
    for number in range(32):
        pool.admit(transaction(number, by=1 + number // 2).wire, NOW_MS)
    with pytest.raises(BlockRobotError, match="SENDER_LIMIT"):
        pool.admit(transaction(32, by=99).wire, NOW_MS)
    for number in range(2):
        pool.admit(transaction(number, by=0).wire, NOW_MS)
    assert [item.body.sender for item in take_all(pool, max_count=4)].count(sender(0).public_key) == 2
    pool.remove([item.txid for item in take_all(pool)])
    assert (len(pool), pool.size_bytes) == (0, 0)
    for number in range(32):
        assert pool.admit(transaction(number, by=1 + number // 2).wire, NOW_MS)[1], "what has left takes no room"


def test_one_grantee_cannot_keep_the_others_of_a_visit_out() -> None:
    pool = _shared({"sender_max_count": 32})
    for number in range(2):
        pool.admit(transaction(number, by=1).wire, NOW_MS)
    with pytest.raises(BlockRobotError, match="SENDER_LIMIT"):
        pool.admit(transaction(2, by=1).wire, NOW_MS)
    assert pool.admit(transaction(2, by=2).wire, NOW_MS)[1]


def test_large_transactions_of_many_grantees_have_one_senders_bytes() -> None:
    size = len(transaction(1).wire)
    pool = _shared({"sender_max_bytes": 16 * 2 * (size + 2)})
    for number in range(30):
        pool.admit(transaction(number, by=1 + number).wire, NOW_MS)
    pool.admit(transaction(30, by=0).wire, NOW_MS)
    room = 32 * (size + 2) - sum(len(item.wire) for item in pool.transactions()[:30])
    large = transaction(31, by=50, arguments=[bytes(room)])
    with pytest.raises(BlockRobotError, match="SENDER_LIMIT"):
        pool.admit(large.wire, NOW_MS)
    assert pool.admit(transaction(31, by=50).wire, NOW_MS)[1]


def test_a_flood_of_records_leaves_room_for_an_erasure() -> None:
    size = len(transaction(1).wire)
    pool = make_pool(max_bytes=20 * (size + 2))
    for number in range(18):
        pool.admit(transaction(number, by=number).wire, NOW_MS)
    with pytest.raises(BlockRobotError, match=r"^MEMPOOL_FULL:"):
        pool.admit(transaction(99, by=99).wire, NOW_MS)
    erasure = transaction(1, by=200, contract="erasure", entry="request")
    assert pool.admit(erasure.wire, NOW_MS)[1]
    assert take_all(pool, max_count=3)[0] == erasure


def test_a_stolen_visit_is_moved_in_a_flood_as_it_can_be_erased_in_one() -> None:
    size = len(transaction(1).wire)
    pool = make_pool(max_bytes=20 * (size + 2))
    for number in range(18):
        pool.admit(transaction(number, by=number).wire, NOW_MS)
    transfer = transaction(1, by=200, contract="records", entry="transfer")
    assert pool.admit(transfer.wire, NOW_MS)[1]
    assert take_all(pool, max_count=3)[0] == transfer


def test_senders_take_turns_and_whoever_was_served_last_goes_to_the_end_of_the_line() -> None:
    pool = make_pool()
    for number in range(5):
        pool.admit(transaction(number, by=0).wire, NOW_MS)
    pool.admit(transaction(0, by=1).wire, NOW_MS)
    assert [item.body.sender for item in take_all(pool, max_count=2)] == [sender(0).public_key, sender(1).public_key]
    pool = make_pool()
    for by in range(3):
        for number in range(2):
            pool.admit(transaction(number, by=by).wire, NOW_MS)
    first = take_all(pool, max_count=2)
    pool.remove([item.txid for item in first])
    assert take_all(pool, max_count=1)[0].body.sender == sender(2).public_key


def test_one_account_takes_a_part_of_a_block_at_most_however_few_others_wait() -> None:
    pool = make_pool()
    contract = next(iter(RESERVED_CONTRACTS))
    for number in range(BLOCK_SHARE_COUNT + 10):
        pool.admit(transaction(number).wire, NOW_MS)
        pool.admit(transaction(1_000 + number, contract=contract).wire, NOW_MS)
    pool.admit(transaction(0, by=1).wire, NOW_MS)
    taken = [item.body.sender for item in take_all(pool)]
    assert (taken.count(sender(0).public_key), len(taken)) == (BLOCK_SHARE_COUNT, BLOCK_SHARE_COUNT + 1)


def test_all_visits_that_one_robot_opened_take_a_part_of_a_block_at_most() -> None:
    def account_of(item: Transaction) -> Account:
        key = item.body.sender
        return Account(key.hex()) if key == sender(9).public_key else Account(key.hex(), True, "visits of a robot")

    pool = make_pool(account_of=account_of)
    for by in range(4):
        for number in range(BLOCK_SHARE_COUNT):
            pool.admit(transaction(number, by=by).wire, NOW_MS)
    pool.admit(transaction(0, by=9).wire, NOW_MS)
    taken = [item.body.sender for item in take_all(pool)]
    assert len(taken) == BLOCK_SHARE_OF_ORIGIN_COUNT + 1
    assert sender(9).public_key in taken


def test_what_is_on_the_branch_or_has_expired_is_neither_taken_nor_kept() -> None:
    pool, first, second = make_pool(), transaction(1), transaction(2)
    pool.admit(first.wire, NOW_MS)
    pool.admit(second.wire, NOW_MS)
    taken = pool.take(max_count=10, max_bytes=1 << 20, timestamp_ms=NOW_MS, exclude={first.txid})
    assert taken == [second]
    assert len(pool) == 2
    pool, short = make_pool(), transaction(1, valid_until_ms=NOW_MS + 10)
    pool.admit(short.wire, NOW_MS)
    assert pool.take(max_count=10, max_bytes=1 << 20, timestamp_ms=NOW_MS + 10) == []
    assert pool.purge_expired(NOW_MS + 9) == []
    assert pool.purge_expired(NOW_MS + 10) == [short.txid]
    assert len(pool) == 0


def test_what_was_signed_while_the_clock_was_ahead_does_not_wait_for_an_hour_once_it_is_put_right() -> None:
    pool, ahead = make_pool(), transaction(1, valid_until_ms=NOW_MS + 3_660_000)
    pool.admit(ahead.wire, NOW_MS + 3_600_000)
    assert pool.purge_expired(NOW_MS + 3_600_000) == []
    assert pool.purge_expired(NOW_MS) == [ahead.txid]
    assert len(pool) == 0


def test_a_transaction_left_out_of_enough_roomy_blocks_is_no_reason_for_another() -> None:
    pool = make_pool()
    pool.admit(transaction(1).wire, NOW_MS)
    for _ in range(3):
        assert pool.has_work((), patience_blocks=4)
        pool.note_block(is_roomy=True)
    pool.note_block(is_roomy=False)
    assert pool.has_work((), patience_blocks=4)
    pool.note_block(is_roomy=True)
    assert not pool.has_work((), patience_blocks=4)
    pool.admit(transaction(2).wire, NOW_MS)
    assert pool.has_work((), patience_blocks=4)


def test_many_keys_of_one_person_fill_the_pool_and_keep_nobody_out() -> None:
    """She has a key for each visit, so shares by key do not hold her: who has little waiting takes the room of the rest."""
    size = len(transaction(1).wire) + 2
    pool = make_pool(max_bytes=100 * size)
    for by in range(10):
        for number in range(12):
            with suppress(BlockRobotError):
                pool.admit(transaction(number, by=by, contract="access", entry="request").wire, NOW_MS)
    assert pool.size_bytes > 98 * size, "it is full"

    calls = (("erasure", "request"), ("consent", "withdraw"), ("identity", "revoke"), ("records", "record"))
    newcomers = [transaction(7, by=50 + n, contract=c, entry=e) for n, (c, e) in enumerate(calls)]
    for newcomer in newcomers:
        assert pool.admit(newcomer.wire, NOW_MS)[1]
    assert pool.evicted_count >= len(calls) - 2
    assert pool.size_bytes <= 100 * size
    assert all(newcomer.txid in pool for newcomer in newcomers)
    assert [item.txid for item in pool.transactions() if item.body.sender in {sender(50).public_key}], "and stay"


def test_what_came_first_of_the_largest_account_is_lost_last() -> None:
    size = len(transaction(1).wire) + 2
    pool = make_pool(max_bytes=20 * size)
    waiting = [transaction(number, by=0) for number in range(17)]
    for item in waiting:
        pool.admit(item.wire, NOW_MS)
    pool.admit(transaction(0, by=1).wire, NOW_MS)
    pool.admit(transaction(0, by=2).wire, NOW_MS)
    assert pool.evicted_count == 1
    assert waiting[-1].txid not in pool
    assert waiting[0].txid in pool


def test_nobody_takes_room_from_accounts_as_large_as_the_own() -> None:
    size = len(transaction(1).wire) + 2
    pool = make_pool(max_bytes=20 * size)
    for number in range(9):
        for by in range(2):
            pool.admit(transaction(number, by=by).wire, NOW_MS)
    with pytest.raises(BlockRobotError, match="MEMPOOL_FULL"):
        pool.admit(transaction(20, by=1).wire, NOW_MS)
    for number in range(2):
        pool.admit(transaction(number, by=2).wire, NOW_MS)
    with pytest.raises(BlockRobotError, match="MEMPOOL_FULL"):
        pool.admit(transaction(2, by=2).wire, NOW_MS)


def test_an_account_has_a_budget_of_bytes_that_time_fills_up() -> None:
    """Also what became final counts: it is kept for a year. The wall clock, which may be put back, fills nothing."""
    size, now = len(transaction(1).wire), {"s": 5.0}
    pool = make_pool(byte_budgets=AccountByteLimiter(lambda: now["s"], bytes_per_s=size, burst_bytes=3 * size))
    for number in range(3):
        pool.admit(transaction(number).wire, NOW_MS)
        pool.remove([transaction(number).txid])
    with pytest.raises(BlockRobotError, match="RATE_LIMITED"):
        pool.admit(transaction(3).wire, NOW_MS + 10_000)
    now["s"] += 0.5
    with pytest.raises(BlockRobotError, match=r"RATE_LIMITED.* used up for 1 s"):
        pool.admit(transaction(3).wire, NOW_MS)
    assert pool.admit(transaction(9, by=1).wire, NOW_MS)[1]
    now["s"] += 0.5
    assert pool.admit(transaction(3).wire, NOW_MS)[1]
    assert pool.admit(transaction(3).wire, NOW_MS) == (transaction(3), False)
    with pytest.raises(BlockRobotError, match="RATE_LIMITED"):
        pool.admit(transaction(4).wire, NOW_MS)


def test_what_is_refused_evicts_nothing_and_pays_nothing() -> None:
    """The first victims were gone and the bytes paid for when it turned out that there were not enough of them."""
    pool, large = make_pool(max_bytes=20_000), transaction(1, by=1, arguments=[bytes(4_000)])
    number = 0
    while pool.ordinary_bytes + 400 < 18_000:
        pool.admit(transaction(number, by=0).wire, NOW_MS)
        number += 1
    assert 4 * len(large.wire) < pool.ordinary_bytes < 5 * len(large.wire), "some may go, and not enough"
    before = (pool.transactions(), pool.evicted_count)
    with pytest.raises(BlockRobotError, match="MEMPOOL_FULL"):
        pool.admit(large.wire, NOW_MS)
    assert (pool.transactions(), pool.evicted_count) == before
    assert large.txid not in pool


def test_what_is_evicted_and_comes_again_is_paid_once() -> None:
    size = len(transaction(1).wire) + 2
    budgets = AccountByteLimiter(lambda: 0.0, bytes_per_s=1, burst_bytes=17 * size)
    pool = make_pool(max_bytes=20 * size, byte_budgets=budgets)
    waiting = [transaction(number, by=0) for number in range(17)]
    for item in waiting:
        pool.admit(item.wire, NOW_MS)
    for by in (1, 2):
        pool.admit(transaction(0, by=by).wire, NOW_MS)
    assert waiting[-1].txid not in pool
    pool.remove([transaction(0, by=1).txid, transaction(0, by=2).txid])
    assert pool.admit(waiting[-1].wire, NOW_MS)[1]
    assert budgets.level(f"key {sender(0).public_key.hex()}") == 17 * size - sum(len(item.wire) for item in waiting)


def test_an_ordinary_call_takes_no_room_from_the_tenth_that_is_kept_for_rights() -> None:
    """The pool was full, so both lanes made room, although only the ordinary one had more than its part."""
    rights = [transaction(number, by=0, contract="erasure", entry="request") for number in range(10)]
    rights_bytes = sum(len(item.wire) for item in rights)
    pool = make_pool(max_bytes=10 * rights_bytes)
    for item in rights:
        pool.admit(item.wire, NOW_MS)
    for number in range(120):
        with suppress(BlockRobotError):
            pool.admit(transaction(number, by=1 + number // 8).wire, NOW_MS)
    for by in range(100, 140):
        with suppress(BlockRobotError):
            pool.admit(transaction(1, by=by).wire, NOW_MS)
    assert pool.evicted_count > 0
    assert all(item.txid in pool for item in rights)


VISITS = 1_000
"""Senders from this number on are visits' keys."""


def _full_of_visits(entry: str = "request", contract: str = "access") -> Mempool:
    """A pool that is full with one transaction of each of many visits."""
    size = len(transaction(1).wire) + 2
    visits = {sender(VISITS + number).public_key for number in range(130)}
    pool = make_pool(
        max_bytes=100 * size, account_of=lambda item: Account(item.body.sender.hex(), item.body.sender in visits)
    )
    for number in range(100):
        with suppress(BlockRobotError):
            pool.admit(transaction(1, by=VISITS + number, contract=contract, entry=entry).wire, NOW_MS)
    return pool


@pytest.mark.parametrize("flood", [("access", "request"), ("records", "transfer"), ("records", "record")])
def test_many_visits_with_one_transaction_each_keep_nobody_out(flood: tuple[str, str]) -> None:
    pool = _full_of_visits(flood[1], flood[0])
    calls = (("erasure", "request"), ("consent", "withdraw"), ("records", "record"))
    members = [
        transaction(7 + n, by=number, contract=c, entry=e) for number in range(3) for n, (c, e) in enumerate(calls)
    ]
    visit = transaction(7, by=VISITS + 120, contract="erasure", entry="request")
    for newcomer in [*members, visit]:
        assert pool.admit(newcomer.wire, NOW_MS)[1]
    assert all(newcomer.txid in pool for newcomer in [*members, visit])
    for number in range(100):
        with suppress(BlockRobotError):
            pool.admit(transaction(2, by=VISITS + number, contract=flood[0], entry=flood[1]).wire, NOW_MS)
    assert all(newcomer.txid in pool for newcomer in members), "visits take from each other alone"


def test_members_that_have_as_much_waiting_lose_nothing_to_a_visit() -> None:
    size = len(transaction(1).wire) + 2
    pool = make_pool(
        max_bytes=20 * size,
        account_of=lambda item: Account(item.body.sender.hex(), is_of_visit=item.body.sender == sender(99).public_key),
    )
    for number in range(18):
        pool.admit(transaction(number, by=number).wire, NOW_MS)
    with pytest.raises(BlockRobotError, match="MEMPOOL_FULL"):
        pool.admit(transaction(99, by=99).wire, NOW_MS)


def test_a_member_cannot_fill_disks_with_junk() -> None:
    """The budget of a day is less than a hundredth of what blocks could hold, and more than a robot records."""
    day_bytes = 24 * 3600 * ACCOUNT_BYTES_PER_S
    assert 24 * 3600 * 1024 < day_bytes < 24 * 3600 * BLOCK_SIZE_MAX_BYTES // 100
    pool = make_pool(byte_budgets=AccountByteLimiter(lambda: 0.0, burst_bytes=64 * 1024))
    junk = [transaction(number, contract="nothing", arguments=[bytes(15_900)]) for number in range(5)]
    for each in junk[:4]:
        pool.admit(each.wire, NOW_MS)
        pool.remove([each.txid])
    with pytest.raises(BlockRobotError, match="RATE_LIMITED"):
        pool.admit(junk[4].wire, NOW_MS)


def test_the_cache_of_checked_transactions_is_bounded_by_count_and_by_bytes() -> None:
    size = len(transaction(0).wire)
    for cache in (TransactionCache(max_count=10), TransactionCache(max_bytes=10 * size)):
        for number in (*range(30), 29, 29):
            cache.add(transaction(number % 30))
        kept = [number for number in range(30) if cache.get(transaction(number).wire)]
        assert len(kept) <= 10
        assert kept[-1] == 29
        assert cache.size_bytes == sum(len(transaction(number).wire) for number in kept)

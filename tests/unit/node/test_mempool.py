"""The pool lets in what may stand in a block, keeps everybody's turn, and stays within its bounds."""

from __future__ import annotations

import pytest
from coincurve.utils import GROUP_ORDER_INT

from consensus.errors import BlockRobotError
from consensus.limits import TRANSACTION_LIFETIME_MAX_MS, TRANSACTION_SIZE_MAX_BYTES
from consensus.primitives.encoding import encode
from consensus.transaction import TransactionWire
from node.mempool import Mempool
from node.transaction_cache import TransactionCache
from tests.unit.node.pool_setup import NOW_MS, make_pool, sender, take_all, transaction


def _refusal(wire: bytes, **changes: object) -> str:
    pool = make_pool(**changes)
    with pytest.raises(BlockRobotError) as caught:
        pool.admit(wire, NOW_MS)
    assert len(pool) == 0
    assert pool.size_bytes == 0
    return caught.value.code


def test_a_good_transaction_waits_and_is_known_when_it_comes_again() -> None:
    pool, wanted = make_pool(), transaction(1)
    assert pool.admit(wanted.wire, NOW_MS) == (wanted, True)
    assert pool.admit(wanted.wire, NOW_MS) == (wanted, False)
    assert wanted.txid in pool
    assert take_all(pool) == [wanted]


def test_truncated_bytes_are_refused() -> None:
    assert _refusal(transaction(1).wire[:-1]) == "ENCODING_INVALID"


def test_an_oversized_transaction_is_refused() -> None:
    wire = encode(TransactionWire(body=bytes(TRANSACTION_SIZE_MAX_BYTES), signature=bytes(65)))
    assert _refusal(wire) == "TRANSACTION_TOO_LARGE"


def test_bytes_in_another_than_the_canonical_form_are_refused() -> None:
    wire = transaction(1).wire
    assert wire[1] == 0xC4
    longer_length = wire[:1] + b"\xc5\x00" + wire[2:]
    assert _refusal(longer_length) == "ENCODING_NOT_CANONICAL"


def test_a_transaction_of_another_chain_is_refused() -> None:
    assert _refusal(transaction(1, chain_id=bytes(32)).wire) == "TRANSACTION_WRONG_CHAIN"


def test_an_expired_transaction_is_refused() -> None:
    assert _refusal(transaction(1, valid_until_ms=NOW_MS).wire) == "TRANSACTION_EXPIRED"


def test_an_expiry_beyond_ten_minutes_is_refused() -> None:
    late = NOW_MS + TRANSACTION_LIFETIME_MAX_MS + 1
    assert _refusal(transaction(1, valid_until_ms=late).wire) == "TRANSACTION_TOO_FAR_AHEAD"


def test_what_is_already_on_the_branch_or_final_is_refused() -> None:
    spent = transaction(1)
    assert _refusal(spent.wire, is_spent=lambda txid: txid == spent.txid) == "TRANSACTION_REPLAYED"


def test_a_signature_by_somebody_else_is_refused() -> None:
    mine = transaction(1)
    forged = TransactionWire(body=mine.body_bytes, signature=transaction(2, by=1).signature)
    assert _refusal(encode(forged)) == "SIGNATURE_INVALID"


def test_a_signature_with_a_high_s_is_refused() -> None:
    mine = transaction(1)
    s = GROUP_ORDER_INT - int.from_bytes(mine.signature[32:64], "big")
    high = mine.signature[:32] + s.to_bytes(32, "big") + bytes([mine.signature[64] ^ 1])
    assert _refusal(encode(TransactionWire(body=mine.body_bytes, signature=high))) == "SIGNATURE_HIGH_S"


def test_a_sender_without_standing_is_refused_and_asked_about_again_next_time() -> None:
    members: set[bytes] = set()
    pool, wanted = make_pool(has_standing=lambda item: item.body.sender in members), transaction(1)
    with pytest.raises(BlockRobotError) as caught:
        pool.admit(wanted.wire, NOW_MS)
    assert caught.value.code == "SENDER_WITHOUT_STANDING"
    members.add(sender(0).public_key)
    assert pool.admit(wanted.wire, NOW_MS)[1]


def test_a_known_signature_is_not_checked_again_but_another_one_over_the_same_body_is() -> None:
    cache, mine = TransactionCache(), transaction(1)
    cache.add(mine)
    assert cache.verified(mine.wire) is mine
    other = TransactionWire(body=mine.body_bytes, signature=transaction(2, by=1).signature)
    with pytest.raises(BlockRobotError):
        cache.verified(encode(other))


def test_one_sender_cannot_fill_the_pool() -> None:
    pool = make_pool(sender_max_count=3)
    for number in range(3):
        pool.admit(transaction(number).wire, NOW_MS)
    with pytest.raises(BlockRobotError) as caught:
        pool.admit(transaction(3).wire, NOW_MS)
    assert caught.value.code == "SENDER_LIMIT"
    assert pool.admit(transaction(3, by=1).wire, NOW_MS)[1]


def _shared(pool_fields: dict[str, int]) -> Mempool:
    """A pool in which all but sender 0 are grantees of one visit."""
    own = sender(0).public_key
    return make_pool(account_of=lambda item: own if item.body.sender == own else b"grantees", **pool_fields)


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
    with pytest.raises(BlockRobotError) as caught:
        pool.admit(transaction(99, by=99).wire, NOW_MS)
    assert caught.value.code == "MEMPOOL_FULL"
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


def test_senders_take_turns() -> None:
    pool = make_pool()
    for number in range(5):
        pool.admit(transaction(number, by=0).wire, NOW_MS)
    pool.admit(transaction(0, by=1).wire, NOW_MS)
    assert [item.body.sender for item in take_all(pool, max_count=2)] == [
        sender(0).public_key,
        sender(1).public_key,
    ]


def test_whoever_was_served_last_goes_to_the_end_of_the_line() -> None:
    pool = make_pool()
    for by in range(3):
        for number in range(2):
            pool.admit(transaction(number, by=by).wire, NOW_MS)
    first = take_all(pool, max_count=2)
    pool.remove([item.txid for item in first])
    assert take_all(pool, max_count=1)[0].body.sender == sender(2).public_key


def test_what_is_on_the_branch_is_not_taken_again() -> None:
    pool, first, second = make_pool(), transaction(1), transaction(2)
    pool.admit(first.wire, NOW_MS)
    pool.admit(second.wire, NOW_MS)
    taken = pool.take(max_count=10, max_bytes=1 << 20, timestamp_ms=NOW_MS, exclude={first.txid})
    assert taken == [second]
    assert len(pool) == 2


def test_what_has_expired_is_neither_taken_nor_kept() -> None:
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

"""Validity in time: nothing early, late, twice, or of another chain."""

from __future__ import annotations

import pytest

from consensus.chain.transaction import Transaction, sign_transaction
from consensus.errors import BlockRobotError
from consensus.limits import TRANSACTION_LIFETIME_MAX_MS
from consensus.primitives.hashing import sha256
from contracts.execution.validity import check_block_transactions, check_transaction, select_valid
from tests.unit.contracts.privacy.hospital import key_of

CHAIN, NOW = sha256(b"chain"), 1_000_000_000


def _transaction(valid_until_ms: int = NOW + 1_000, chain_id: bytes = CHAIN, salt: int = 0) -> Transaction:
    return sign_transaction(
        key_of("anyone"),
        chain_id=chain_id,
        contract="identity",
        entry="authenticate",
        arguments=[b"x" * 32],
        valid_until_ms=valid_until_ms,
        salt=salt.to_bytes(8, "big"),
    )


@pytest.mark.parametrize("valid_until_ms", [NOW + 1, NOW + TRANSACTION_LIFETIME_MAX_MS])
def test_an_expiry_within_ten_minutes_is_valid(valid_until_ms: int) -> None:
    check_transaction(_transaction(valid_until_ms), CHAIN, NOW, frozenset())


@pytest.mark.parametrize(
    ("valid_until_ms", "code"),
    [
        (NOW, "TRANSACTION_EXPIRED"),
        (0, "TRANSACTION_EXPIRED"),
        (NOW + TRANSACTION_LIFETIME_MAX_MS + 1, "TRANSACTION_TOO_FAR_AHEAD"),
    ],
)
def test_an_expiry_outside_ten_minutes_is_not(valid_until_ms: int, code: str) -> None:
    with pytest.raises(BlockRobotError, match=code):
        check_transaction(_transaction(valid_until_ms), CHAIN, NOW, frozenset())


def test_another_chain_and_a_replay_are_refused() -> None:
    with pytest.raises(BlockRobotError, match="TRANSACTION_WRONG_CHAIN"):
        check_transaction(_transaction(chain_id=bytes(32)), CHAIN, NOW, frozenset())
    known = _transaction()
    with pytest.raises(BlockRobotError, match="TRANSACTION_REPLAYED"):
        check_transaction(known, CHAIN, NOW, {known.txid})


def _check(transactions: list[Transaction], parent_time_ms: int = NOW - 1) -> None:
    check_block_transactions(
        transactions, chain_id=CHAIN, parent_time_ms=parent_time_ms, time_ms=NOW, recent=frozenset()
    )


def test_a_block_lies_after_its_parent_and_holds_each_transaction_once_and_not_too_many() -> None:
    _check([_transaction()])
    for parent_time_ms in (NOW, NOW + 1):
        with pytest.raises(BlockRobotError, match="BLOCK_INVALID"):
            _check([], parent_time_ms)
    with pytest.raises(BlockRobotError, match="twice"):
        _check([_transaction(), _transaction()])
    with pytest.raises(BlockRobotError, match="too many"):
        _check([_transaction(salt=number) for number in range(257)])


def test_one_bad_transaction_spoils_the_block_but_not_the_leaders_choice() -> None:
    good, late, other = _transaction(), _transaction(NOW), _transaction(salt=1)
    with pytest.raises(BlockRobotError, match="TRANSACTION_EXPIRED"):
        _check([good, late])
    chosen = select_valid([late, good, good, other], chain_id=CHAIN, time_ms=NOW, recent={other.txid})
    assert chosen == [good]

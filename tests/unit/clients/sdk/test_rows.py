"""Rows and queries put to proofs: what was not proved is never taken for absent, and an answer is the query's own."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from clients.sdk.chain.proved_rows import (
    in_session,
    proved_list,
    proved_row,
    proved_rows,
    put_query,
)
from clients.sdk.proof_checks import ProvedState
from consensus.api_documents import PROOF_KEYS_MAX_COUNT
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode_value
from consensus.primitives.keys import PrivateKey
from consensus.state.access import GRANT_COUNT, GRANT_NUMBER
from consensus.state.identity import HANDLE, MEMBER, REMOVED, active_role, member_with
from consensus.state.keys import DecodedReader, UnreadError
from consensus.state.records import VISIT, current_owner, decided_root
from tests.unit.contracts.privacy import callers
from tests.unit.contracts.privacy.hospital import Hospital

KEY = PrivateKey(bytes([7] * 32))


class Proofs:
    """Proves a state, at most 128 keys at once; `asked` are the keys of each question."""

    def __init__(self, state: Any) -> None:
        self.state = state
        self.asked: list[list[bytes]] = []

    async def state_values(self, keys: Sequence[bytes], key: PrivateKey) -> ProvedState:
        assert key is KEY
        assert 1 <= len(keys) <= PROOF_KEYS_MAX_COUNT
        self.asked.append(list(keys))
        found = {flat: self.state.get(flat) for flat in keys}
        return ProvedState(1, 1, {flat: None if data is None else decode_value(data) for flat, data in found.items()})


@pytest.fixture(scope="module")
def chain() -> Any:
    return callers.Scene(Hospital()).hospital


@pytest.fixture
def proofs(chain: Any) -> Proofs:
    return Proofs(chain.state)


async def test_a_query_of_the_state_says_the_same_put_to_proofs(chain: Any, proofs: Proofs) -> None:
    read = in_session(proofs, KEY)
    handles = [HANDLE.split(key)[0] for key, _ in chain.state.scan(HANDLE.flat, 100)]
    members = [MEMBER.split(key)[0] for key, _ in chain.state.scan(MEMBER.flat, 100)]
    owners = [VISIT.split(key)[0] for key, _ in chain.state.scan(VISIT.flat, 100)]
    queries = [
        *(lambda state, each=each: member_with(state, each) for each in [*handles, bytes(32)]),
        *(lambda state, each=each: active_role(state, each) for each in [*members, bytes(33)]),
        *(lambda state, each=each: current_owner(state, each) for each in owners),
        *(lambda state, each=each: decided_root(state, each) for each in [*owners, bytes(33)]),
    ]
    assert min(map(len, (handles, members, owners))) > 1
    for query in queries:
        assert await put_query(read, query) == query(chain.state)


async def test_no_key_is_asked_for_twice_and_none_that_the_query_does_not_need(chain: Any, proofs: Proofs) -> None:
    member = MEMBER.split(next(iter(chain.state.scan(MEMBER.flat, 1)))[0])[0]
    await put_query(in_session(proofs, KEY), lambda state: active_role(state, member))
    assert proofs.asked == [[MEMBER.key(member)], [REMOVED.key(MEMBER.at(chain.state, member).org)]]


def test_what_was_not_proved_is_not_absent() -> None:
    member = bytes(33)
    with pytest.raises(KeyError):
        MEMBER.among({}, member)
    with pytest.raises(KeyError):
        GRANT_COUNT.among({})
    with pytest.raises(UnreadError):
        active_role(DecodedReader({}), member)
    assert MEMBER.among({MEMBER.key(member): None}, member) is None
    assert active_role(DecodedReader({MEMBER.key(member): None}), member) == ""


async def test_an_error_of_the_query_itself_is_no_key_to_read(proofs: Proofs) -> None:
    with pytest.raises(KeyError):
        await put_query(in_session(proofs, KEY), lambda state: {b"other": state}[b"key"])
    assert proofs.asked == []


async def test_many_keys_are_asked_for_in_parts_and_a_row_that_is_missing_is_no_row(proofs: Proofs) -> None:
    read = in_session(proofs, KEY)
    assert await read([]) == {}
    keys = [VISIT.key(bytes([number]) * 33) for number in range(200)]
    assert list(await read(keys)) == keys
    assert [len(part) for part in proofs.asked] == [PROOF_KEYS_MAX_COUNT, 72]
    assert await proved_row(read, VISIT, bytes(33)) is None
    with pytest.raises(BlockRobotError, match="PROOF_INVALID"):
        await proved_rows(read, VISIT, [bytes(33)])


async def test_a_list_has_as_many_ids_as_its_count_says(chain: Any, proofs: Proofs) -> None:
    read = in_session(proofs, KEY)
    ids = await proved_list(read, GRANT_COUNT, GRANT_NUMBER)
    assert ids == [GRANT_NUMBER.at(chain.state, number) for number in range(GRANT_COUNT.read(chain.state) or 0)]
    assert ids
    proofs.state = {GRANT_COUNT.flat: GRANT_COUNT.encode(1)}
    with pytest.raises(BlockRobotError):
        await proved_list(read, GRANT_COUNT, GRANT_NUMBER)

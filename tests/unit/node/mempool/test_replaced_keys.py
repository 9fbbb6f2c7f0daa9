"""A limit counts for who holds a key, not for the key: whoever replaces it has no more left than before."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from consensus.limits import DAY_MS, MIB_BYTES
from consensus.members.vouchers import CARD_TAG, sign_rotation
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.state.identity import handle_of, organisation_of
from consensus.state.settings import read_quotas
from contracts.execution.sender_admission import find_account, is_admitted
from contracts.state.view import MemoryState
from node.api.access.principals import resolve_principal
from node.custody.uploads.upload_usage import DayUse, UploadTerms, require_quota
from node.limits.account_byte_limiter import VISITS_PART, AccountByteLimiter
from node.mempool.mempool import Mempool
from node.mempool.transaction_cache import TransactionCache
from tests.unit.contracts.privacy.hospital import Hospital, Person

BURST_BYTES = 64 * 64 * 1024
JUNK_BYTES = 15_000


class SnapshotOf:
    """A finalized state, as the API reads it."""

    def __init__(self, state: MemoryState) -> None:
        self.get = state.get
        self._state = state

    def scan(self, prefix: bytes, limit: int) -> list[tuple[bytes, bytes]]:
        return list(self._state.scan(prefix, limit))


class Story:
    """A hospital, a mempool before it with a small budget, and somebody who brings junk."""

    def __init__(self) -> None:
        self.hospital = Hospital()
        self.budgets = AccountByteLimiter(lambda: 0.0, burst_bytes=BURST_BYTES)
        self.anna = self.hospital.enrol("anna")
        self.visit = self.hospital.open_visit(self.anna)
        self.transfers = 0
        hospital = self.hospital
        self.pool = Mempool(
            chain_id=hospital.chain_id,
            cache=TransactionCache(),
            check_admission=lambda item: is_admitted(hospital.state, item, hospital.time_ms),
            is_spent=lambda _: False,
            account_of=lambda item: find_account(hospital.state, item),
            byte_budgets=self.budgets,
        )

    def junk(self, key: PrivateKey, contract: str = "consent", entry: str = "x", *first: Any) -> Transaction:
        return self.hospital.sign(key, contract, entry, *first, bytes(JUNK_BYTES))

    def spend(self, key: PrivateKey, contract: str) -> int:
        """Send junk until it is refused, as if each became final at once; return how much was taken."""
        taken = 0
        while True:
            item = self.junk(key, contract)
            if not self.is_taken(item):
                return taken
            taken += len(item.wire)

    def is_taken(self, item: Transaction) -> bool:
        """Tell whether a transaction may wait; if so it becomes final at once."""
        code = ""
        try:
            self.pool.admit(item.wire, self.hospital.time_ms)
        except BlockRobotError as refusal:
            code = refusal.code
        assert code in ("", "RATE_LIMITED")
        self.pool.remove([item.txid])
        return not code

    def rotate(self, person: Person, key: PrivateKey) -> PrivateKey:
        new = PrivateKey(sha256(key.public_key))
        keys = {"spend": person.spend.public_key, "view": person.view.public_key, "sealing": person.sealing}
        signature = sign_rotation(
            new, chain_id=self.hospital.chain_id, handle=person.handle, member=key.public_key, **keys
        )
        self.hospital.must(key, "identity", "rotate", person.handle, new.public_key, *keys.values(), signature)
        return new

    def transfer(self, key: PrivateKey) -> PrivateKey:
        self.transfers += 1
        return self.hospital.transfer(self.visit, self.anna, 100 + self.transfers, key)


def _of_member(story: Story) -> tuple[PrivateKey, str, Callable[[PrivateKey], PrivateKey]]:
    return story.anna.identity, "consent", lambda key: story.rotate(story.anna, key)


def _of_robot(story: Story) -> tuple[PrivateKey, str, Callable[[PrivateKey], PrivateKey]]:
    return story.hospital.robot.identity, "records", lambda key: story.rotate(story.hospital.robot, key)


def _of_visit(story: Story) -> tuple[PrivateKey, str, Callable[[PrivateKey], PrivateKey]]:
    return story.visit.key, "rights", story.transfer


HOLDERS = {"member": _of_member, "robot": _of_robot, "visit": _of_visit}


@pytest.mark.parametrize("holder", HOLDERS)
def test_no_map_of_limits_knows_a_new_key_from_the_one_before(holder: str) -> None:
    story = Story()
    key, contract, replace_key = HOLDERS[holder](story)

    def names(key: PrivateKey) -> list[Any]:
        state, item = story.hospital.state, story.junk(key, contract)
        assert is_admitted(state, item, story.hospital.time_ms)
        account = find_account(state, item)
        standing = resolve_principal(SnapshotOf(story.hospital.state), key.public_key)
        assert standing is not None
        return [account, account.name_payer(key.public_key), standing.account, handle_of(state, key.public_key)]

    before = names(key)
    assert not any(key.public_key.hex() in str(name) for name in before) or holder == "visit", (
        "a visit's first key is its name"
    )
    for _ in range(2):
        key = replace_key(key)
        assert names(key) == before


@pytest.mark.parametrize("holder", HOLDERS)
def test_a_new_key_does_not_fill_the_budget_of_bytes_anew(holder: str) -> None:
    story = Story()
    key, contract, replace_key = HOLDERS[holder](story)
    part = VISITS_PART if holder == "visit" else 1
    assert BURST_BYTES // part - 2 * JUNK_BYTES < story.spend(key, contract) <= BURST_BYTES // part
    for _ in range(3):
        key = replace_key(key)
        assert story.spend(key, contract) == 0


def test_all_visits_that_one_robot_opened_have_one_budget_together() -> None:
    story = Story()
    taken = story.spend(story.visit.key, "rights")
    for number in range(1, VISITS_PART + 20):
        taken += story.spend(story.hospital.open_visit(story.anna, number).key, "rights")
    assert taken <= BURST_BYTES
    other = story.hospital.enrol("other-robot", "robot")
    assert story.spend(story.hospital.open_visit(story.anna, 999, other).key, "rights") > 0
    assert story.spend(story.anna.identity, "consent") > BURST_BYTES // 2, "nor does it take from members"


def test_one_card_signs_no_more_registrations_than_one_account_may_have() -> None:
    """Its holder signs as many as she likes, each for another key and all of them wrong."""
    story = Story()
    card, person, taken = story.hospital.card("newcomer"), Person("newcomer"), 0
    for number in range(BURST_BYTES // JUNK_BYTES + 20):
        item = sign_registration(story, person, card, PrivateKey(sha256(number.to_bytes(4, "big"))))
        taken += len(item.wire) if story.is_taken(item) else 0
    assert BURST_BYTES - 2 * JUNK_BYTES < taken <= BURST_BYTES


def sign_registration(story: Story, person: Person, card: Any, key: PrivateKey) -> Transaction:
    """A registration whose card signature is good, and in which a key has the size of junk."""
    keys = [bytes(JUNK_BYTES), person.view.public_key, person.sealing]
    message = story.hospital.chain_id + card.handle + key.public_key + b"".join(keys)
    signature = PrivateKey(card.card_secret).sign(CARD_TAG, message)
    arguments = [card.handle, card.card_public, card.role, card.not_after_ms, card.voucher_signature]
    return story.hospital.sign(key, "identity", "register", *arguments, *keys, signature, [])


def test_a_robot_with_a_new_key_has_no_new_quota_of_uploads() -> None:
    story = Story()
    hospital, key = story.hospital, story.hospital.robot.identity
    quotas, today = read_quotas(hospital.state.get), hospital.time_ms // DAY_MS
    used = [DayUse(today, key.public_key, quotas.robot_day_max_mib * MIB_BYTES)]

    def refusal_of(robot: bytes) -> str:
        state = hospital.state
        terms = UploadTerms(
            robot, quotas, lambda each: organisation_of(state, each), lambda each: handle_of(state, each)
        )
        try:
            require_quota(1, terms, {}, used, hospital.time_ms)
        except BlockRobotError as refusal:
            return str(refusal)
        return ""

    assert "robot_day_max_mib" in refusal_of(key.public_key)
    for _ in range(2):
        key = story.rotate(hospital.robot, key)
        assert "robot_day_max_mib" in refusal_of(key.public_key)
    assert refusal_of(hospital.enrol("other-robot", "robot").identity.public_key) == ""

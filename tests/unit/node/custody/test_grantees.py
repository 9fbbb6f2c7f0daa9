"""Who may fetch what was shared, by the state: told on the real contracts, with members who come and go."""

from __future__ import annotations

import pytest

from consensus.chain.transaction import sign_transaction
from consensus.errors import BlockRobotError
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.records.sharing import GRANT_STEP_MS, SharedRequest, hash_grant_member
from contracts.execution.sender_admission import find_account, name_grantees
from node.custody.chain_facts import require_grantee, require_open_grant
from tests.unit.contracts.privacy.hospital import DAY_MS, Hospital, Person, Visit, key_of

SALT, KEY = sha256(b"salt"), key_of("grantee")


class Story:
    """A record that was shared with somebody, and asked for by the grant's key."""

    def __init__(self, role: str = "staff") -> None:
        self.hospital = Hospital()
        self.nurse: Person = self.hospital.enrol("nurse", role)
        self.visit: Visit = self.hospital.open_visit(self.hospital.enrol("anna"))
        self.record_id = self.hospital.record(self.visit)
        self.other_id = self.hospital.record(self.visit)
        end = self.hospital.time_ms + DAY_MS
        self.until_ms = end - end % GRANT_STEP_MS
        words = [[self.record_id, self.other_id], KEY.public_key, key_of("ephemeral").public_key, 7]
        words += [hash_grant_member(SALT, self.nurse.handle), "care", self.until_ms]
        self.grant_id = self.hospital.must(self.visit.key, "access", "grant", *words).txid
        asked = self.hospital.must(KEY, "access", "request_granted", self.grant_id, [self.record_id], "care")
        self.access_id = asked.txid

    def code(self, **changes: bytes | int) -> str:
        """Return the code of the refusal, or an empty text if she passes."""
        words = {
            "record_id": self.record_id,
            "access_id": self.access_id,
            "handle": self.nurse.handle,
            "salt": SALT,
            "with_frames": True,
        } | {name: value for name, value in changes.items() if name in SharedRequest.__struct_fields__}
        request = SharedRequest(**words)  # type: ignore[arg-type]
        grant_id, key = changes.get("grant_id", self.grant_id), changes.get("key", KEY.public_key)
        now_ms = changes.get("now_ms", self.hospital.time_ms)
        assert isinstance(grant_id, bytes)
        assert isinstance(key, bytes)
        assert isinstance(now_ms, int)
        try:
            require_grantee(self.hospital.state, request, grant_id, key, now_ms)
        except BlockRobotError as error:
            return error.code
        return ""


@pytest.mark.parametrize("role", ["staff", "officer"])
def test_staff_and_officers_pass_with_the_handle_and_the_salt_of_the_grant(role: str) -> None:
    assert Story(role).code() == ""


@pytest.mark.parametrize("role", ["subject", "auditor", "robot"])
def test_no_other_role_does(role: str) -> None:
    assert Story(role).code() == "GRANTEE_NOT_A_MEMBER"


def test_who_is_not_of_the_staff_now_gets_nothing() -> None:
    story = Story()
    other = story.hospital.enrol("colleague", "staff")
    assert story.code(handle=other.handle) == "GRANTEE_NOT_A_MEMBER"
    assert story.code(salt=bytes(32)) == "GRANTEE_NOT_A_MEMBER"
    assert story.code(salt=b"", handle=b"") == "GRANTEE_NOT_A_MEMBER"
    story.hospital.must(story.hospital.admin, "identity", "revoke", story.nurse.handle)
    assert story.code() == "GRANTEE_NOT_A_MEMBER"


def test_only_the_grants_key_passes_and_only_for_what_it_asked() -> None:
    story = Story()
    own = story.hospital.must(story.visit.key, "access", "request", [story.record_id], "own-access").txid
    assert story.code(key=story.visit.owner) == "NOT_PERMITTED"
    assert story.code(key=story.nurse.identity.public_key) == "NOT_PERMITTED"
    assert story.code(grant_id=bytes(32)) == "NOT_PERMITTED"
    assert story.code(access_id=own) == "ACCESS_NOT_GRANTED"
    assert story.code(access_id=bytes(32)) == "ACCESS_NOT_GRANTED"
    assert story.code(record_id=story.other_id) == "ACCESS_NOT_GRANTED"


def test_a_grant_that_was_revoked_or_is_over_opens_nothing_whatever_a_custodian_has_followed() -> None:
    story = Story()
    assert story.code(now_ms=story.until_ms) == "GRANT_ENDED"
    story.hospital.must(story.visit.key, "access", "revoke", story.grant_id)
    assert story.code() == "GRANT_ENDED"


def test_parts_are_taken_for_a_grant_that_may_come_or_stands_and_not_after_its_end() -> None:
    story = Story()
    state, now_ms = story.hospital.state, story.hospital.time_ms
    require_open_grant(state, bytes(32), now_ms)
    require_open_grant(state, story.grant_id, story.until_ms - 1)
    with pytest.raises(BlockRobotError, match=r"^GRANT_ENDED:"):
        require_open_grant(state, story.grant_id, story.until_ms)
    story.hospital.must(story.visit.key, "access", "revoke", story.grant_id)
    with pytest.raises(BlockRobotError, match=r"^GRANT_ENDED:"):
        require_open_grant(story.hospital.state, story.grant_id, now_ms)


def test_all_grantees_of_a_visit_wait_in_one_line_and_its_owner_in_her_own() -> None:
    story = Story()
    heir = story.hospital.enrol("heir")

    def line(key: PrivateKey, contract: str, entry: str, grant_id: bytes = story.grant_id) -> str:
        words = {"chain_id": story.hospital.chain_id, "valid_until_ms": story.hospital.time_ms, "salt": bytes(8)}
        transaction = sign_transaction(key, contract=contract, entry=entry, arguments=[grant_id], **words)  # type: ignore[arg-type]
        return find_account(story.hospital.state, transaction).name

    other = key_of("another grantee")
    words = [[story.other_id], other.public_key, key_of("e").public_key, 7, bytes(32), "care", story.until_ms]
    granted = story.hospital.must(story.visit.key, "access", "grant", *words).txid
    keys = ((KEY, story.grant_id), (other, granted))
    lines = {line(key, "access", entry, of) for key, of in keys for entry in ("request_granted", "noticed")}
    assert lines == {name_grantees(story.visit.owner)}
    new = story.hospital.transfer(story.visit, heir)
    assert line(KEY, "access", "noticed") in lines, "whoever decides of the visit"
    for key, entry in ((new, "request"), (new, "noticed"), (KEY, "verdict"), (other, "noticed")):
        expected = f"visit {story.visit.owner.hex()}" if key == new else f"key {key.public_key.hex()}"
        assert line(key, "access", entry) == expected, "the visit's own line is that of its first key"
    own = f"key {KEY.public_key.hex()}"
    for strange in (b"", bytes(31), bytes(32), granted):
        assert line(KEY, "access", "noticed", strange) == own, "it names no grant of this key"
    assert line(KEY, "erasure", "request_granted") == own

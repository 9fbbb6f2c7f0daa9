"""Stories of sharing: granted by the owner, asked for by the grantee, ended by word, by time, by what befalls a record."""

from __future__ import annotations

from typing import Any

import pytest

from consensus.limits import GRANT_NOTICE_MS, GRANTS_OPEN_MAX_COUNT
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.records.owner_keys import sign_transfer
from consensus.records.sharing import (
    GRANT_MAX_MS,
    GRANT_STEP_MS,
    derive_grantee_key,
    hash_grant_member,
    open_grant_keys,
    scan_grant,
)
from contracts.execution.sender_admission import Account, find_account, is_admitted, name_grantees
from tests.unit.contracts.privacy.hospital import DAY_MS, Hospital, Person, Visit, data_of, key_of

SALT = sha256(b"salt of the grant")


def until(hospital: Hospital, days: int = 7) -> int:
    later = hospital.time_ms + days * DAY_MS
    return later - later % GRANT_STEP_MS


def words_for(hospital: Hospital, visit: Visit, nurse: Person, number: int = 0, **changes: Any) -> list[Any]:
    """Return the arguments of a grant, as a wallet makes them."""
    secret = sha256(b"ephemeral %d" % number)
    public = (nurse.view.public_key, nurse.spend.public_key)
    made = open_grant_keys(secret, *public, chain_id=hospital.chain_id, owner=visit.owner)
    words = {
        "records": visit.records[:2],
        "grantee": made.owner,
        "ephemeral": made.ephemeral,
        "view_tag": made.view_tag,
        "member_hash": hash_grant_member(SALT, nurse.handle),
        "purpose": "care",
        "until_ms": until(hospital),
    }
    return list({**words, **changes}.values())


def key_for(hospital: Hospital, visit: Visit, nurse: Person, number: int = 0) -> PrivateKey:
    ephemeral = PrivateKey(sha256(b"ephemeral %d" % number)).public_key
    return derive_grantee_key(nurse.spend, nurse.view, ephemeral, chain_id=hospital.chain_id, owner=visit.owner)


@pytest.fixture
def nurse(hospital: Hospital) -> Person:
    return hospital.enrol("nurse", "staff")


@pytest.fixture
def shared(hospital: Hospital, visit: Visit, nurse: Person) -> bytes:
    return hospital.must(visit.key, "access", "grant", *words_for(hospital, visit, nurse)).txid


def kinds_of(hospital: Hospital, visit: Visit) -> list[str]:
    return [event["kind"] for event in hospital.view("audit", "events", visit.owner, 0, 100)]


def test_what_is_shared_is_found_and_asked_for_by_nobody_but_the_grantee(
    hospital: Hospital, visit: Visit, nurse: Person
) -> None:
    words = words_for(hospital, visit, nurse)
    granted = hospital.must(visit.key, "access", "grant", *words)
    (grant_id,) = hospital.view("access", "grants", 0, 10)
    assert grant_id == granted.txid
    grant = hospital.view("access", "grant_of", grant_id)
    where = {"chain_id": hospital.chain_id, "owner": grant["owner"]}
    found = scan_grant(nurse.view, nurse.spend.public_key, grant["ephemeral"], grant["view_tag"], **where)
    assert found == grant["grantee"]
    key = key_for(hospital, visit, nurse)
    asked = hospital.must(key, "access", "request_granted", grant_id, visit.records[:1], "care")
    assert data_of(asked, "requested")["grant"] == grant_id
    hospital.must(hospital.custodians[0], "access", "released", asked.txid, visit.records[:1])
    for meddler in (visit.key, nurse.identity, key_of("stranger")):
        refused = hospital.send(meddler, "access", "request_granted", grant_id, visit.records[:1], "care")
        assert refused.code == "NOT_THE_GRANTEE"
    assert kinds_of(hospital, visit)[-3:] == ["granted", "access_requested", "access_released"]
    asked_event = hospital.view("audit", "events", visit.owner, 0, 100)[-2]
    assert asked_event["data"]["grant"] == grant_id


def test_nothing_on_the_chain_is_the_grantees(hospital: Hospital, visit: Visit, nurse: Person, shared: bytes) -> None:
    """Neither her member key, nor her public keys, nor her handle stand in what a grant writes."""
    written = dict(hospital.state.scan(b"access\x00", 1000))
    own = (nurse.identity, nurse.spend, nurse.view)
    told = b"".join(key + value for key, value in written.items())
    assert shared in told
    assert nurse.handle not in told
    assert not any(key.public_key in told for key in own)


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"records": []}, "RECORDS_MISSING"),
        ({"records": [bytes(16)]}, "RECORD_UNKNOWN"),
        ({"records": [bytes(15)]}, "RECORD_ID_WRONG"),
        ({"records": [bytes(16), bytes(16)]}, "RECORD_ID_WRONG"),
        ({"records": [number.to_bytes(16, "big") for number in range(65)]}, "RECORDS_TOO_MANY"),
        ({"grantee": bytes(32)}, "KEY_SIZE_WRONG"),
        ({"view_tag": 256}, "VIEW_TAG_WRONG"),
        ({"member_hash": b""}, "MEMBER_HASH_WRONG"),
        ({"purpose": "curiosity"}, "PURPOSE_UNKNOWN"),
        ({"purpose": "own-access"}, "PURPOSE_OWN"),
        ({"until_ms": 0}, "UNTIL_WRONG"),
    ],
)
def test_a_grant_outside_the_limits_is_refused(
    hospital: Hospital, visit: Visit, nurse: Person, changes: dict[str, Any], code: str
) -> None:
    assert hospital.send(visit.key, "access", "grant", *words_for(hospital, visit, nurse, **changes)).code == code


def test_a_grant_ends_on_five_full_minutes_and_in_a_year(hospital: Hospital, visit: Visit, nurse: Person) -> None:
    last = hospital.time_ms + GRANT_MAX_MS
    for until_ms in (until(hospital) + 1000, last - last % GRANT_STEP_MS + GRANT_STEP_MS):
        words = words_for(hospital, visit, nurse, until_ms=until_ms)
        assert hospital.send(visit.key, "access", "grant", *words).code == "UNTIL_WRONG"
    hospital.must(
        visit.key, "access", "grant", *words_for(hospital, visit, nurse, until_ms=last - last % GRANT_STEP_MS)
    )


def test_the_key_of_a_grant_is_no_members(hospital: Hospital, visit: Visit, nurse: Person, shared: bytes) -> None:
    assert hospital.view("access", "grant_of", shared)["status"] == "active"
    words = words_for(hospital, visit, nurse, grantee=nurse.identity.public_key)
    assert hospital.send(visit.key, "access", "grant", *words).code == "GRANTEE_WRONG"


def test_only_the_owner_shares_and_revokes(hospital: Hospital, visit: Visit, nurse: Person, shared: bytes) -> None:
    other = hospital.open_visit(hospital.enrol("ben"))
    fresh = words_for(hospital, visit, nurse, number=1)
    assert hospital.send(other.key, "access", "grant", *fresh).code == "NOT_THE_OWNER"
    assert hospital.send(nurse.identity, "access", "grant", *fresh).code == "VISIT_UNKNOWN"
    assert hospital.send(other.key, "access", "revoke", shared).code == "NOT_THE_OWNER"
    grantee = key_for(hospital, visit, nurse)
    assert hospital.send(grantee, "access", "revoke", shared).code == "VISIT_UNKNOWN"
    assert hospital.send(grantee, "access", "request", visit.records[:1], "care").code == "VISIT_UNKNOWN"
    assert hospital.send(visit.key, "access", "revoke", bytes(32)).code == "GRANT_UNKNOWN"


def test_a_revoked_grant_opens_nothing_and_is_revoked_once(
    hospital: Hospital, visit: Visit, nurse: Person, shared: bytes
) -> None:
    revoked = hospital.must(visit.key, "access", "revoke", shared)
    assert data_of(revoked, "revoked") == {"grant_id": shared, "owner": visit.owner}
    assert hospital.send(visit.key, "access", "revoke", shared).code == "GRANT_ENDED"
    key = key_for(hospital, visit, nurse)
    asked = hospital.send(key, "access", "request_granted", shared, visit.records[:1], "care")
    assert asked.code == "GRANT_ENDED"


def test_a_grant_ends_with_its_time(hospital: Hospital, visit: Visit, nurse: Person, shared: bytes) -> None:
    hospital.time_ms = hospital.view("access", "grant_of", shared)["until_ms"] - 100  # the next block's time is its end
    key = key_for(hospital, visit, nurse)
    asked = hospital.send(key, "access", "request_granted", shared, visit.records[:1], "care")
    assert asked.code == "GRANT_ENDED"
    assert hospital.send(visit.key, "access", "revoke", shared).code == "GRANT_ENDED"


def test_a_grantee_asks_for_what_was_shared_and_for_what(
    hospital: Hospital, visit: Visit, nurse: Person, shared: bytes
) -> None:
    key = key_for(hospital, visit, nurse)
    for records, purpose, code in (
        (visit.records[2:], "care", "RECORD_NOT_GRANTED"),
        ([], "care", "RECORDS_MISSING"),
        (visit.records[:1] * 2, "care", "RECORD_ID_WRONG"),
        (visit.records[:1], "research", "PURPOSE_OTHER"),
    ):
        assert hospital.send(key, "access", "request_granted", shared, records, purpose).code == code


@pytest.mark.parametrize("whole", [False, True])
def test_a_restriction_that_came_later_bars_the_grantee_and_every_new_grant(
    hospital: Hospital, visit: Visit, nurse: Person, shared: bytes, whole: bool
) -> None:
    """Also for a complaint: only the person herself looks at what is restricted."""
    complaint = words_for(hospital, visit, nurse, number=1, purpose="complaint")
    filed = hospital.must(visit.key, "access", "grant", *complaint).txid
    restricted = [] if whole else visit.records[:1]
    hospital.must(visit.key, "rights", "restrict", restricted, "accuracy")
    for number, grant_id, purpose in ((0, shared, "care"), (1, filed, "complaint")):
        key = key_for(hospital, visit, nurse, number)
        asked = hospital.send(key, "access", "request_granted", grant_id, visit.records[:1], purpose)
        assert asked.code == "RECORD_RESTRICTED"
    again = words_for(hospital, visit, nurse, number=2, purpose="complaint")
    assert hospital.send(visit.key, "access", "grant", *again).code == "RECORD_RESTRICTED"
    hospital.must(visit.key, "rights", "lift", restricted)
    hospital.must(key_for(hospital, visit, nurse), "access", "request_granted", shared, visit.records[:1], "care")


def test_an_objection_and_a_quarantine_bar_the_grantee(
    hospital: Hospital, visit: Visit, nurse: Person, shared: bytes
) -> None:
    key = key_for(hospital, visit, nurse)
    hospital.must(visit.key, "rights", "object_to_release", ["care"])
    asked = hospital.send(key, "access", "request_granted", shared, visit.records[:1], "care")
    assert asked.code == "PURPOSE_OBJECTED"
    hospital.must(visit.key, "rights", "wrong_person")
    asked = hospital.send(key, "access", "request_granted", shared, visit.records[:1], "care")
    assert asked.code == "VISIT_QUARANTINED"
    fresh = words_for(hospital, visit, nurse, number=1, purpose="safety")
    assert hospital.send(visit.key, "access", "grant", *fresh).code == "VISIT_QUARANTINED"


def test_an_erased_record_is_neither_shared_nor_released_and_the_grantee_says_that_she_knows(
    hospital: Hospital, visit: Visit, nurse: Person, shared: bytes
) -> None:
    key, (first, second, _) = key_for(hospital, visit, nurse), visit.records
    hospital.must(visit.key, "erasure", "request", [first], [])
    asked = hospital.send(key, "access", "request_granted", shared, [first], "care")
    assert asked.code == "RECORD_ERASED"
    assert hospital.send(visit.key, "access", "grant", *words_for(hospital, visit, nurse, 1)).code == "RECORD_ERASED"
    hospital.must(key, "access", "noticed", shared, [first])
    assert hospital.view("access", "grant_of", shared)["noticed"] == [first]
    assert hospital.send(key, "access", "noticed", shared, [first]).code == "NOTICE_EXISTS"
    assert kinds_of(hospital, visit)[-1] == "grant_noticed"
    hospital.must(key, "access", "noticed", shared, [second])
    assert hospital.view("access", "grant_of", shared)["noticed"] == [first], (
        "of a correction there is no copy to delete"
    )
    hospital.must(visit.key, "access", "revoke", shared)
    hospital.must(key, "access", "noticed", shared, [second])
    assert hospital.view("access", "grant_of", shared)["noticed"] == [first, second]


def test_only_the_grantee_says_that_she_was_told(
    hospital: Hospital, visit: Visit, nurse: Person, shared: bytes
) -> None:
    assert hospital.send(visit.key, "access", "noticed", shared, visit.records[:1]).code == "NOT_THE_GRANTEE"
    key = key_for(hospital, visit, nurse)
    assert hospital.send(key, "access", "noticed", shared, visit.records[2:]).code == "RECORD_NOT_GRANTED"


def test_a_visit_that_was_transferred_is_shared_and_revoked_by_its_new_key(
    hospital: Hospital, visit: Visit, nurse: Person, shared: bytes
) -> None:
    new = hospital.transfer(visit, hospital.enrol("heir"))
    assert hospital.send(visit.key, "access", "revoke", shared).code == "VISIT_TRANSFERRED"
    later = hospital.must(new, "access", "grant", *words_for(hospital, visit, nurse, number=1)).txid
    assert hospital.view("access", "grant_of", later)["owner"] == visit.owner
    hospital.must(new, "access", "revoke", shared)


def test_the_largest_grant_fits_the_limits_of_a_call(hospital: Hospital, visit: Visit, nurse: Person) -> None:
    while len(visit.records) < 64:
        hospital.record(visit)
    words = words_for(hospital, visit, nurse, records=visit.records)
    grant_id = hospital.must(visit.key, "access", "grant", *words).txid
    key = key_for(hospital, visit, nurse)
    asked = hospital.must(key, "access", "request_granted", grant_id, visit.records, "care")
    hospital.must(hospital.custodians[0], "access", "released", asked.txid, sorted(visit.records))
    hospital.must(visit.key, "access", "revoke", grant_id)
    hospital.must(key, "access", "noticed", grant_id, visit.records)


def test_64_grants_of_a_visit_stand_at_once(hospital: Hospital, visit: Visit, nurse: Person) -> None:
    """Everybody of the staff reads every grant, and custodians keep parts of each: nobody may share without end."""
    words = words_for(hospital, visit, nurse)
    first = hospital.must(visit.key, "access", "grant", *words).txid
    for number in range(1, GRANTS_OPEN_MAX_COUNT):
        later = until(hospital, 7 if number > 1 else 1)
        hospital.must(visit.key, "access", "grant", *words_for(hospital, visit, nurse, number, until_ms=later))

    def share(number: int, of: Visit = visit) -> str:
        return hospital.send(of.key, "access", "grant", *words_for(hospital, of, nurse, number)).code

    assert share(64) == "GRANTS_TOO_MANY"
    other = hospital.open_visit(hospital.enrol("ben"))
    hospital.record(other)
    assert share(64, other) == "OK"
    hospital.must(visit.key, "access", "revoke", first)
    assert (share(65), share(66)) == ("OK", "GRANTS_TOO_MANY")
    hospital.time_ms += DAY_MS
    assert (share(67), share(68)) == ("OK", "GRANTS_TOO_MANY")


@pytest.mark.parametrize("ended_by", ["word", "time"])
def test_the_key_of_a_grant_says_something_for_90_days_after_the_end(
    hospital: Hospital, visit: Visit, nurse: Person, shared: bytes, ended_by: str
) -> None:
    key = key_for(hospital, visit, nurse)
    asking: list[Any] = [shared, visit.records[:1], "care"]

    def waits(entry: str, *arguments: Any) -> bool:
        transaction = hospital.sign(key, "access", entry, *arguments)
        return is_admitted(hospital.state, transaction, hospital.time_ms)

    assert waits("request_granted", *asking)
    assert not waits("request", visit.records[:1], "care")
    if ended_by == "word":
        hospital.must(visit.key, "access", "revoke", shared)
        ended_ms = hospital.time_ms
    else:
        ended_ms = hospital.time_ms = hospital.view("access", "grant_of", shared)["until_ms"]
    assert hospital.view("access", "grant_of", shared)["ended_ms"] == ended_ms
    assert not waits("request_granted", *asking)
    hospital.time_ms = ended_ms + GRANT_NOTICE_MS - 60_000
    assert waits("noticed", shared, visit.records[:1])
    hospital.must(key, "access", "noticed", shared, visit.records[:1])
    hospital.time_ms = ended_ms + GRANT_NOTICE_MS
    assert not waits("noticed", shared, visit.records[1:2])
    assert hospital.send(key, "access", "noticed", shared, visit.records[1:2]).code == "GRANT_ENDED"


def origin_of(hospital: Hospital) -> str:
    return f"visits of {hospital.robot.handle.hex()}"


def test_nobody_spends_a_visits_key_by_sharing_with_it_first(hospital: Hospital, visit: Visit, nurse: Person) -> None:
    """Whoever operates a node sees a robot's announcement on its way, and could refuse it by a grant to that very key."""
    key, root = key_of("anna's visit"), key_of("anna's visit").public_key
    stolen = words_for(hospital, visit, nurse, grantee=root)
    grant_id = hospital.must(visit.key, "access", "grant", *stolen).txid
    opened = [root, key_of("r").public_key, 7, hospital.bucket(), "care"]
    hospital.must(hospital.robot.identity, "records", "open_visit", *opened)
    asking = hospital.sign(key, "access", "request", [], "care")
    assert is_admitted(hospital.state, asking, hospital.time_ms)
    assert find_account(hospital.state, asking) == Account(f"visit {root.hex()}", True, origin_of(hospital)), (
        "in her own turns, not in those of his grantees"
    )
    hospital.must(key, "access", "request", [], "care")
    hospital.must(key, "rights", "restrict", [], "accuracy")
    new = key_of("anna's next key")
    agreed = sign_transfer(new, chain_id=hospital.chain_id, root=root)
    hospital.must(visit.key, "access", "grant", *words_for(hospital, visit, nurse, 1, grantee=new.public_key))
    hospital.must(key, "records", "transfer", new.public_key, key_of("r").public_key, 7, agreed)
    assert hospital.send(key, "access", "request", [], "care").code == "VISIT_TRANSFERRED"
    assert hospital.view("access", "grant_of", grant_id)["owner"] == visit.owner


def test_a_visit_under_a_grantees_key_takes_nothing_from_her(
    hospital: Hospital, visit: Visit, nurse: Person, shared: bytes
) -> None:
    """A robot that lies would otherwise make her an owner, and lock her out; nor is she one by a transfer unasked."""
    key = key_for(hospital, visit, nurse)
    other = hospital.open_visit(hospital.enrol("ben"))
    agreed = sign_transfer(other.key, chain_id=hospital.chain_id, root=other.owner)
    taken = hospital.send(other.key, "records", "transfer", key.public_key, key_of("r").public_key, 7, agreed)
    assert taken.code == "TRANSFER_SIGNATURE_WRONG"
    reopened = [key.public_key, key_of("r").public_key, 7, hospital.bucket(), "care"]
    hospital.must(hospital.robot.identity, "records", "open_visit", *reopened)
    asking = hospital.sign(key, "access", "request_granted", shared, visit.records[:1], "care")
    assert find_account(hospital.state, asking) == Account(
        name_grantees(visit.owner), is_of_visit=True, origin=origin_of(hospital), is_shared=True
    )
    hospital.must(key, "access", "request_granted", shared, visit.records[:1], "care")


def test_another_grant_to_the_same_key_takes_nothing_from_the_first_or_the_second(
    hospital: Hospital, visit: Visit, nurse: Person
) -> None:
    """Whoever sees a grant on its way could otherwise share with its key first, and spend it."""
    thief = hospital.open_visit(hospital.enrol("ben"))
    key = key_for(hospital, visit, nurse)
    words = words_for(hospital, visit, nurse, records=[hospital.record(thief)], grantee=key.public_key)
    squatting = hospital.must(thief.key, "access", "grant", *words).txid
    hospital.must(thief.key, "access", "revoke", squatting)
    meant = hospital.must(visit.key, "access", "grant", *words_for(hospital, visit, nurse)).txid
    asking = hospital.sign(key, "access", "request_granted", meant, visit.records[:1], "care")
    assert is_admitted(hospital.state, asking, hospital.time_ms)
    ended = hospital.sign(key, "access", "request_granted", squatting, visit.records[:1], "care")
    assert not is_admitted(hospital.state, ended, hospital.time_ms)
    hospital.must(key, "access", "request_granted", meant, visit.records[:1], "care")


def test_a_grantee_asks_64_times_a_day_and_takes_nothing_from_the_owners_day(
    hospital: Hospital, visit: Visit, nurse: Person, shared: bytes
) -> None:
    ask = ("access", "request_granted", shared, visit.records[:1], "care")
    key = key_for(hospital, visit, nurse)
    for _ in range(2):
        assert all(receipt.ok for receipt in hospital.block([hospital.sign(key, *ask) for _ in range(32)]))
    assert hospital.send(key, *ask).code == "WORDS_TOO_MANY"
    hospital.must(visit.key, "access", "request", visit.records[:1], "own-access")
    assert hospital.value("audit", b"day/access/" + visit.owner)[1] == 2, "the grant and the owner's own request"
    hospital.time_ms += DAY_MS
    hospital.must(key, *ask)

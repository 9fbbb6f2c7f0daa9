"""Keys and rows of the state: built and taken apart, strict in what a row has, and deaf to fields of a later version."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode_value, encode_value, u32
from consensus.state import audit, identity, lifecycle, membership, records
from consensus.state.layout import owners_of

OWNER = b"\x02" + b"/" * 32
MEMBER = {
    "handle": bytes(32),
    "role": "staff",
    "org": "ward",
    "spend": b"",
    "view": b"",
    "sealing": b"",
    "status": "active",
    "since": 7,
}


def state(**rows: Any) -> dict[bytes, bytes]:
    return {identity.MEMBER.key(OWNER): encode_value(MEMBER | rows)}


def test_a_key_is_built_of_its_parts_and_taken_apart() -> None:
    assert records.RECORD.key(bytes(16)) == b"records\x00record/" + bytes(16)
    assert audit.ENTRY.key(OWNER, 3) == b"audit\x00entry/" + OWNER + u32(3)
    assert audit.ENTRY.split(audit.ENTRY.key(OWNER, 3)) == (OWNER, u32(3))
    revoked = membership.REVOKED.key("ward", bytes(20))
    assert revoked == b"membership\x00revoked/ward/" + bytes(20)
    assert membership.REVOKED.split(revoked) == (b"ward", bytes(20))
    assert lifecycle.VERSION.key("audit", 2) == b"lifecycle\x00version/audit/" + u32(2)
    assert records.OF_VISIT.key(OWNER, bytes(16)).startswith(records.OF_VISIT.start(OWNER))
    with pytest.raises(BlockRobotError, match="is no key of records record/"):
        records.RECORD.split(b"records\x00record/" + bytes(15))


def test_one_kind_owns_a_key_and_nobody_a_key_that_no_contract_writes() -> None:
    for key in (
        audit.DAY_OF_VISIT.key("rights", OWNER),
        audit.DAY_OF_GRANT.key("access", b"/" * 32),
        audit.DAY_OF_OFFICERS.key("rights", OWNER),
        lifecycle.SOURCE.key(b"/" * 32),
        lifecycle.SOURCE_PART.key(b"/" * 32, 1),
        identity.CUSTODIANS.flat,
        identity.CUSTODIAN.key(OWNER),
    ):
        assert len(owners_of(key)) == 1
    assert owners_of(b"records\x00new/" + OWNER) == []
    assert owners_of(identity.CUSTODIANS.flat + b"/") == []


@pytest.mark.parametrize("change", [{"since": "7"}, {"since": True}, {"status": "asleep"}, {"handle": "text"}])
def test_a_row_with_a_value_of_another_kind_is_refused(change: dict[str, Any]) -> None:
    with pytest.raises(BlockRobotError, match="identity member/"):
        identity.MEMBER.at(state(**change), OWNER)
    with pytest.raises(BlockRobotError, match="identity member/"):
        identity.MEMBER.convert(MEMBER | change)


def test_a_row_that_lacks_a_field_is_refused_and_ends_the_walk() -> None:
    part = {name: value for name, value in MEMBER.items() if name != "org"}
    with pytest.raises(BlockRobotError, match="`org`"):
        identity.MEMBER.at({identity.MEMBER.key(OWNER): encode_value(part)}, OWNER)
    table = Table({audit.COUNT.key(OWNER): encode_value("two")})
    with pytest.raises(BlockRobotError, match="audit count/"):
        list(audit.COUNT.rows(table))


def test_readers_pass_over_a_field_of_a_later_version_that_a_strict_look_refuses() -> None:
    later = state(nickname="Anna")
    found = identity.MEMBER.at(later, OWNER)
    assert found is not None
    assert found.org == "ward"
    assert identity.active_role(later, OWNER) == "staff"
    (data,) = later.values()
    assert identity.MEMBER.convert(decode_value(data)) == found
    with pytest.raises(BlockRobotError, match="nickname"):
        identity.MEMBER.decode(data)


def test_a_part_that_a_list_may_lack_at_its_end_is_left_out_where_it_is_not() -> None:
    parts = [OWNER, OWNER, 7, 300_000, OWNER]
    for value in (parts, [*parts, OWNER]):
        data = encode_value(value)
        row = records.ANNOUNCEMENT.decode(data)
        assert row.root == (OWNER if len(value) == 6 else b"")
        assert records.ANNOUNCEMENT.encode(row) == data


def test_what_is_absent_or_was_removed_with_its_organisation_gives_no_role() -> None:
    assert identity.MEMBER.at({}, OWNER) is None
    assert identity.active_role({}, OWNER) == ""
    assert records.decided_root({}, OWNER) is None
    assert audit.entry_keys(OWNER, 3, 1) == [audit.ENTRY.key(OWNER, 1), audit.ENTRY.key(OWNER, 2)]
    removed = {identity.REMOVED.key("ward"): encode_value(7)}
    assert identity.active_role(state() | removed, OWNER) == ""
    assert identity.active_role(state(since=8) | removed, OWNER) == "staff"
    assert identity.active_role(state(role="subject") | removed, OWNER) == "subject"
    assert identity.active_role(state(status="left"), OWNER) == ""


class Table(dict[bytes, bytes]):
    """A state in memory that can be scanned."""

    def scan(self, prefix: bytes, limit: int) -> Iterator[tuple[bytes, bytes]]:
        return iter([(key, value) for key, value in sorted(self.items()) if key.startswith(prefix)][:limit])


def test_all_rows_under_a_prefix_come_in_key_order_with_the_parts_of_their_keys() -> None:
    other = b"\x03" + bytes(32)
    entry = {"record_id": b"", "kind": "denied", "time": 1, "height": 2, "data": {}, "of_later": 1}
    table = Table(
        {audit.ENTRY.key(owner, number): encode_value(entry) for owner in (other, OWNER) for number in (1, 0)}
    )
    table[audit.COUNT.key(OWNER)] = encode_value(2)
    found = list(audit.ENTRY.rows(table))
    assert [parts for parts, _ in found] == [(owner, u32(number)) for owner in (OWNER, other) for number in (0, 1)]
    assert {row.kind for _, row in found} == {"denied"}
    assert [parts for parts, _ in audit.ENTRY.rows(table, other)] == [(other, u32(0)), (other, u32(1))]
    assert len(list(audit.ENTRY.rows(table, limit=3))) == 3
    table[audit.ENTRY.start(OWNER)] = encode_value(entry)
    with pytest.raises(BlockRobotError, match="is no key of audit entry/"):
        list(audit.ENTRY.rows(table))

"""What an organisation tells people stands on the chain: by its admins, in versions, none of which goes again."""

from __future__ import annotations

from consensus.primitives.encoding import decode_value
from consensus.rights.notices import encode_notice, notice_digest, read_published, read_row
from consensus.state.consent import NOTICE, NOTICE_TEXT
from network.notices.notice_publishing import demo_notice
from tests.unit.contracts.privacy.hospital import Hospital, data_of, key_of


def test_versions_follow_each_other_and_all_stay(hospital: Hospital) -> None:
    first, second = encode_notice(demo_notice()), b"what another version says"
    receipt = hospital.must(hospital.admin, "consent", "publish_notice", first)
    hospital.must(hospital.admin, "consent", "publish_notice", second)
    told = {"organisation": "ward", "version": 1, "hash": notice_digest(first)}
    assert data_of(receipt, "notice_published") == told
    row = read_row("ward", decode_value(hospital.state.get(NOTICE.key("ward")) or b""))
    assert row is not None
    assert (row.version, row.digest, row.height) == (2, notice_digest(second), hospital.height)
    kept = read_published("ward", decode_value(hospital.state.get(NOTICE_TEXT.key(1, "ward")) or b""))
    assert kept is not None
    assert (kept.row.version, kept.notice) == (1, demo_notice())


def test_an_admin_alone_publishes_and_a_new_notice_changes_no_consent(hospital: Hospital) -> None:
    anna = hospital.enrol("anna")
    for key in (anna.identity, hospital.registrar, hospital.custodians[0], key_of("stranger")):
        assert hospital.send(key, "consent", "publish_notice", b"words").code == "NOT_AN_ADMIN"
    assert hospital.value("consent", b"notice/ward") is None
    before = [hospital.value("consent", key) for key in (b"changes", b"of/" + anna.handle)]
    hospital.must(hospital.admin, "consent", "publish_notice", b"words")
    assert [hospital.value("consent", key) for key in (b"changes", b"of/" + anna.handle)] == before


def test_what_is_in_force_is_not_published_twice_nor_anything_empty_or_endless(hospital: Hospital) -> None:
    hospital.must(hospital.admin, "consent", "publish_notice", b"words")
    assert hospital.send(hospital.admin, "consent", "publish_notice", b"words").code == "NOTICE_UNCHANGED"
    for document in (b"", b"x" * 14_001):
        assert hospital.send(hospital.admin, "consent", "publish_notice", document).code == "NOTICE_SIZE_WRONG"
    hospital.must(hospital.admin, "consent", "publish_notice", b"x" * 14_000)

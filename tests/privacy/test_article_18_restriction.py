"""GDPR Article 18: a person may have what was recorded of her restricted.

(1) on each of the four grounds of paragraph 1; (2) nothing but storing is done with it from then on, but for her own
purposes; (3) what she restricts for a claim, or in place of erasure, is not erased because its time is over; (4) no
majority can switch it off; (6) keeping has an end, lest a lost key keep a person's pictures for ever. That nobody but she
lifts it (paragraph 3), and that she can still erase: `security/test_authorisation_entries.py`,
`unit/contracts/privacy/test_rights.py`; that the custodian keeps it: `offchain/test_standing.py`.
"""

from __future__ import annotations

import pytest

from consensus.rights.purposes import PURPOSES
from consensus.rights.right_codes import GROUNDS, KEEP_MS, KEEPING_GROUNDS, OWN_PURPOSES
from contracts.lifecycle.changes import GOVERNING
from tests.offchain.conftest import house, make_store  # noqa: F401 - fixtures
from tests.offchain.house import ACCESS_ID, CustodianHarness, refused
from tests.offchain.small_chain import ALICE, access
from tests.offchain.test_standing import restricted
from tests.unit.contracts.privacy.hospital import DAY_MS, Hospital, Visit


@pytest.mark.parametrize("ground", sorted(GROUNDS))
def test_1_there_are_the_four_grounds_of_the_law(hospital: Hospital, visit: Visit, ground: str) -> None:
    hospital.must(visit.key, "rights", "restrict", visit.records[:1], ground)
    assert "Art. 18(1)" in GROUNDS[ground]
    assert len(GROUNDS) == 4


def test_4_no_majority_can_switch_it_off() -> None:
    assert "rights" in GOVERNING


def test_2_nobody_else_has_it_released(hospital: Hospital, visit: Visit) -> None:
    hospital.must(visit.key, "rights", "restrict", [], "accuracy")
    for purpose in PURPOSES:
        receipt = hospital.send(visit.key, "access", "request", [], purpose)
        assert receipt.ok == (purpose in OWN_PURPOSES), purpose


@pytest.mark.parametrize("make_store", ["sqlite"], indirect=True)
async def test_2_a_request_that_was_open_ends_with_it_and_storing_goes_on(house: CustodianHarness) -> None:  # noqa: F811
    async with house.open() as custodian:
        clip = await house.keep()
        await house.follow(access(ACCESS_ID, clip))
        await house.follow(restricted(clip))
        await refused("ACCESS_ENDED", custodian.download(clip.record_id, ACCESS_ID, ALICE))
        assert (await custodian.export(clip.record_id)).record_id == clip.record_id


@pytest.mark.parametrize("ground", sorted(GROUNDS))
def test_3_what_she_needs_is_kept_and_the_rest_is_not(hospital: Hospital, visit: Visit, ground: str) -> None:
    hospital.must(visit.key, "rights", "restrict", [], ground)
    hospital.time_ms += 31 * DAY_MS
    receipt = hospital.send(hospital.custodians[0], "erasure", "expired", visit.records, bytes(32))
    assert receipt.ok == (ground not in KEEPING_GROUNDS)


def test_6_keeping_has_an_end_and_can_be_said_again(hospital: Hospital, visit: Visit) -> None:
    hospital.must(visit.key, "rights", "restrict", [], "legal-claim")
    hospital.time_ms += KEEP_MS - DAY_MS
    hospital.must(visit.key, "rights", "restrict", [], "legal-claim")
    hospital.time_ms += 2 * DAY_MS
    custodian = hospital.custodians[0]
    assert hospital.send(custodian, "erasure", "expired", visit.records, bytes(32)).code == "RECORD_RESTRICTED"
    hospital.time_ms += KEEP_MS
    hospital.must(custodian, "erasure", "expired", visit.records, bytes(32))

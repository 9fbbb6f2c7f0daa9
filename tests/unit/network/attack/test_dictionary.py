"""The dictionary finds every UID that a scheme makes public a function of, and none of ours."""

from __future__ import annotations

import hashlib

import pytest

from network.lab.privacy.attacks.dictionary import computed_costs, enumerate_uids, search_chain, search_marks
from network.lab.privacy.hospital.population import make_uid
from network.lab.privacy.hospital.schemes import make_schemes
from tests.unit.network.attack.conftest import SERIAL_BITS, SmallHospital

UIDS = [make_uid(serial, SERIAL_BITS) for serial in (0, 17, 1023)]


def test_every_uid_is_tried_once_and_a_salt_costs_a_pass_for_each_mark() -> None:
    tried = [uid.decode() for uids in enumerate_uids(SERIAL_BITS) for uid in uids]
    assert tried == [make_uid(serial, SERIAL_BITS) for serial in range(1 << SERIAL_BITS)]
    schemes = make_schemes()
    last = [UIDS[-1]] * 4
    once = search_marks(schemes["prototype"].marks(last), b"", SERIAL_BITS)
    each = search_marks(schemes["salted"].marks(last), b"", SERIAL_BITS)
    assert each.hashes == 4 * once.hashes
    assert search_marks(make_schemes()["peppered"].marks(UIDS), b"", SERIAL_BITS).found == {}


@pytest.mark.parametrize("name", ["prototype", "salted", "pepper_stolen"])
def test_a_hash_of_a_uid_gives_it_away(name: str) -> None:
    scheme = make_schemes()[name]
    found = search_marks(scheme.marks(UIDS), scheme.known_pepper or b"", SERIAL_BITS).found
    assert found == dict(enumerate(UIDS))


@pytest.mark.parametrize("planted", ["hash", "half", "tagged", "plain", "key"])
def test_a_trace_of_a_uid_anywhere_on_our_chain_would_be_found(hospital: SmallHospital, planted: str) -> None:
    from consensus.primitives.hashing import tagged_hash

    uid = UIDS[1]
    digest = hashlib.sha256(uid.encode()).digest()
    traces = {
        "hash": digest,
        "half": digest[:16],
        "tagged": tagged_hash("blockrobot/handle", uid.encode()),
        "plain": uid.encode(),
        "key": b"\x02" + digest,
    }
    chain_id = hospital.played.chain.chain_id
    found = search_chain(hospital.evidence.marks | {traces[planted]}, chain_id, SERIAL_BITS).found
    assert uid in found.values()


def test_our_chain_holds_no_trace_of_any_uid(hospital: SmallHospital) -> None:
    marks = hospital.evidence.marks
    assert len(marks) > 500
    assert hospital.evidence.visits[0].owner in marks
    assert search_chain(marks, hospital.played.chain.chain_id, SERIAL_BITS).found == {}


def test_the_cost_of_longer_uids_is_computed_from_the_rate() -> None:
    costs = computed_costs(2.0**20)
    assert costs["computed_dictionary_32_bit_core_hours"] == pytest.approx(4096 / 3600, rel=1e-2)
    assert costs["computed_dictionary_40_bit_core_hours"] == pytest.approx(2**20 / 3600, rel=1e-2)
    assert set(costs) == {
        f"computed_dictionary_{bits}_bit_{where}_hours" for bits in (32, 40, 56, 96) for where in ("core", "gpu")
    }

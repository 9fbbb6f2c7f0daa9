"""GDPR Article 21: a person may object, at any time, to processing for a purpose.

(1) nothing more is recorded of her for it, by whatever sensor, whatever she or anybody said before; (2) nothing that was
recorded is released for it any more; (3) other purposes are untouched; (4) it needs no reason, and no consent that could
be withdrawn: `unit/contracts/privacy/test_rights.py`; (5) nothing that she says joins her to her visits; (6) she cannot
be led to lock herself out.
"""

from __future__ import annotations

import pytest

from consensus.primitives.encoding import decode_value
from consensus.rights.purposes import PURPOSES
from consensus.rights.right_codes import OWN_PURPOSES
from consensus.rights.sensors import SENSORS
from consensus.state.consent import effective_consent, read_choices
from tests.unit.contracts.privacy.hospital import Hospital, Person, Visit


def _consented(hospital: Hospital, person: Person) -> set[str]:
    """The purposes for which a robot that reads the chain now would record."""
    choices = read_choices(hospital.value("consent", b"of/" + person.handle))
    return {purpose for (purpose, _), steps in choices.items() if effective_consent(steps, hospital.height)}


def test_1_nothing_more_is_recorded_by_any_sensor(hospital: Hospital, anna: Person) -> None:
    everything = (sorted(PURPOSES), sorted(SENSORS))
    hospital.must(anna.identity, "consent", "give", anna.handle, *everything, 0, 0, 0, hospital.height)
    hospital.block([])
    assert _consented(hospital, anna) == set(PURPOSES)
    hospital.must(anna.identity, "rights", "object_to", anna.handle, ["research"])
    assert "research" not in _consented(hospital, anna), "a robot heeds it as soon as it sees it"
    hospital.block([])
    assert _consented(hospital, anna) == set(PURPOSES) - {"research"}


def test_2_and_3_nothing_is_released_for_it_and_everything_else_is(hospital: Hospital, visit: Visit) -> None:
    hospital.must(visit.key, "rights", "object_to_release", ["research"])
    for purpose in PURPOSES:
        receipt = hospital.send(visit.key, "access", "request", [], purpose)
        assert receipt.ok == (purpose != "research"), purpose


def test_5_nothing_joins_her_to_her_visit(hospital: Hospital, anna: Person, visit: Visit) -> None:
    """Of her two words, the one names her and no visit, the other a visit and not her."""
    recording = hospital.must(anna.identity, "rights", "object_to", anna.handle, ["research"])
    release = hospital.must(visit.key, "rights", "object_to_release", ["research"])
    hers = {anna.identity.public_key, anna.handle}
    for receipt, forbidden in ((recording, {visit.owner}), (release, hers)):
        told = repr([decode_value(event.data) for event in receipt.events])
        assert not [one for one in forbidden if repr(one)[2:-1] in told]
    assert not [key for key in hospital.state.scan(b"rights\x00", 1 << 20) if any(one in key[0] for one in hers)]


@pytest.mark.parametrize("purpose", OWN_PURPOSES)
def test_6_she_is_not_locked_out(hospital: Hospital, anna: Person, visit: Visit, purpose: str) -> None:
    assert hospital.send(visit.key, "rights", "object_to_release", [purpose]).code == "PURPOSE_OWN"
    assert hospital.send(anna.identity, "rights", "object_to", anna.handle, [purpose]).code == "PURPOSE_OWN"

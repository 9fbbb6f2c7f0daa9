"""GDPR Article 25: data protection by design, and by default the least.

By design: (1) nothing on the chain joins two visits of one person; (2) no function of a card's number leaves the desk of
the registrar. By default: (3) who says nothing is not recorded; (4) who registers is recorded by the depth camera alone,
for what she named: `unit/contracts/privacy/test_consent.py`; (5) a robot that does not know keeps nothing; (6) nobody's
records are open to anybody unless she acts.
"""

from __future__ import annotations

from pathlib import Path

from clients.registrar.registrar import Registrar
from clients.robot.hiding.withhold_reason import WithholdReason
from consensus.members.vouchers import decode_card_code
from consensus.rights.purposes import PURPOSES
from consensus.rights.sensors import SENSORS
from tests.unit.clients.robot.test_consents import ANN, Ward, story
from tests.unit.contracts.privacy.hospital import Hospital, Person

UID = "E2801160600002054A1B2C3D"


def _allowed(hospital: Hospital, person: Person) -> list[tuple[str, str]]:
    return [
        (purpose, sensor)
        for purpose in sorted(PURPOSES)
        for sensor in sorted(SENSORS)
        if hospital.view("consent", "allowed", person.handle, purpose, sensor)
    ]


def _register(hospital: Hospital, name: str, purposes: list[str]) -> Person:
    person, card = Person(name), hospital.card(name)
    arguments = hospital.register_arguments(person, card, purposes=purposes)
    hospital.must(person.identity, "identity", "register", *arguments)
    person.handle = card.handle
    hospital.block([])
    return person


def test_1_nothing_on_the_chain_joins_two_visits(hospital: Hospital) -> None:
    anna = hospital.enrol("anna")
    first, second = hospital.open_visit(anna, 0), hospital.open_visit(anna, 1)
    of_first, of_second = (
        {value for value in hospital.view("records", "visit", visit.owner).values() if isinstance(value, bytes)}
        for visit in (first, second)
    )
    assert of_first & of_second == {hospital.robot.identity.public_key}
    hers = {anna.handle, anna.identity.public_key, anna.spend.public_key, anna.view.public_key, anna.sealing}
    visits = b"".join(key + value for key, value in hospital.state.scan(b"records\x00", 10_000))
    assert not [key for key in hers if key in visits]


def test_2_a_cards_code_says_nothing_of_its_number(hospital: Hospital, tmp_path: Path) -> None:
    (tmp_path / "registrar.key").write_bytes(hospital.registrar.secret)
    first, second = (decode_card_code(Registrar(tmp_path, hospital.genesis).issue(UID, "subject")) for _ in range(2))
    assert first.handle != second.handle
    assert first.card_secret != second.card_secret


def test_3_who_says_nothing_is_not_recorded(hospital: Hospital) -> None:
    assert _allowed(hospital, _register(hospital, "anna", [])) == []


@story()
async def test_5_a_robot_that_does_not_know_keeps_nothing(ward: Ward) -> None:
    ward.registry.say(ANN)
    assert ward.refusal() is WithholdReason.STALE, "it has not asked yet"
    await ward.consents.refresh()
    assert ward.refusal() is None
    assert ward.refusal(handle=b"?" * 32) is WithholdReason.NO_CONSENT, "it has not heard of that person"


def test_6_nobody_is_let_in_unless_she_acts(hospital: Hospital) -> None:
    visit = hospital.open_visit(hospital.enrol("anna"))
    record_id = hospital.record(visit)
    for person in ("staff", "officer", "auditor"):
        key = hospital.enrol(person, person).identity
        for purpose in PURPOSES:
            assert hospital.send(key, "access", "request", [record_id], purpose).code == "VISIT_UNKNOWN"

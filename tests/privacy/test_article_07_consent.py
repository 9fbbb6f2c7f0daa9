"""GDPR Article 7(3): consent can be withdrawn at any time, as easily as it was given, and people are told so first.

(1) it is possible at any time, whatever else was said; (2) it takes no more than giving did; (3) nobody can stand in the
way; (4) it does not undo what was lawful before; (5) silence, and being registered, are no consent to more (Art. 4(11)).
"""

from __future__ import annotations

from click.testing import CliRunner

from clients.wallet.commands.consent_commands import consent
from consensus.limits import CALL_GAS_MAX
from consensus.rights.purposes import PURPOSES
from consensus.rights.sensors import SENSORS
from contracts.lifecycle.changes import GOVERNING
from tests.unit.contracts.privacy.hospital import Hospital, Person, Visit

EVERYTHING = (sorted(PURPOSES), sorted(SENSORS))


def _gas(hospital: Hospital, person: Person, entry: str, *arguments: object) -> int:
    if entry == "give":
        arguments = (*arguments, hospital.height)
    return hospital.must(person.identity, "consent", entry, person.handle, *arguments).gas_used


def _allowed(hospital: Hospital, person: Person) -> list[tuple[str, str]]:
    purposes, sensors = EVERYTHING
    return [
        (purpose, sensor)
        for purpose in purposes
        for sensor in sensors
        if hospital.view("consent", "allowed", person.handle, purpose, sensor)
    ]


def test_1_it_is_possible_at_any_time(hospital: Hospital, anna: Person) -> None:
    """In the block after, years after, in the middle of a visit, before what was given began."""
    _gas(hospital, anna, "withdraw", [], [])
    for wait_ms, ahead in ((0, 0), (3 * 365 * 24 * 3600 * 1000, 0), (0, 1_000)):
        _gas(hospital, anna, "give", *EVERYTHING, 0, 0, hospital.height + ahead if ahead else 0)
        hospital.time_ms += wait_ms
        hospital.open_visit(anna, hospital.height)
        _gas(hospital, anna, "withdraw", [], [])
        hospital.block([])
        assert _allowed(hospital, anna) == []


def test_2_it_takes_no_more_than_giving_did(hospital: Hospital, anna: Person) -> None:
    _gas(hospital, anna, "give", *EVERYTHING, 0, 0, 0)
    taken = _gas(hospital, anna, "withdraw", [], [])
    given = _gas(hospital, anna, "give", *EVERYTHING, 0, 0, 0)
    assert taken <= given < CALL_GAS_MAX // 2, "over the same choices"
    parameters = {name: len(consent.commands[name].params) for name in ("give", "withdraw")}
    assert parameters["withdraw"] < parameters["give"]
    assert "consent withdraw" in CliRunner().invoke(consent, ["--help"]).output


def test_3_nobody_stands_in_the_way(hospital: Hospital, anna: Person) -> None:
    """No majority can switch the contract off, and nobody can give in her place what she took back."""
    assert "consent" in GOVERNING
    _gas(hospital, anna, "withdraw", [], [])
    for key in (hospital.admin, hospital.registrar, hospital.robot.identity, *hospital.custodians):
        for entry, arguments, code in (
            ("give", [*EVERYTHING, 0, 0, 0, hospital.height], "NOT_THE_MEMBER"),
            ("begin", [["care"]], "NOT_THE_IDENTITY_CONTRACT"),
            ("end", [], "NOT_THE_IDENTITY_CONTRACT"),
        ):
            assert hospital.send(key, "consent", entry, anna.handle, *arguments).code == code
    hospital.block([])
    assert _allowed(hospital, anna) == []


def test_4_it_does_not_undo_what_was_lawful_before(hospital: Hospital, anna: Person) -> None:
    visit: Visit = hospital.open_visit(anna)
    record_id = hospital.record(visit)
    _gas(hospital, anna, "withdraw", [], [])
    assert hospital.view("records", "get", record_id)["status"] == "active"
    hospital.must(visit.key, "erasure", "request", [record_id], [])
    assert hospital.view("records", "get", record_id)["status"] == "erasing"


def test_5_silence_and_being_registered_are_no_consent_to_more(hospital: Hospital, anna: Person) -> None:
    """Registering, she named two purposes; nothing else follows from that, and nothing from a purpose to a sensor."""
    hospital.block([])
    assert _allowed(hospital, anna) == [("care", "depth"), ("demo", "depth")]

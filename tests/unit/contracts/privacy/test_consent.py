"""Stories of consent: what is said, from when it holds, and how little it takes to say no."""

from __future__ import annotations

from typing import Any

import pytest

from consensus.limits import CALL_GAS_MAX
from consensus.members.vouchers import sign_rotation
from consensus.rights.purposes import PURPOSES
from consensus.rights.sensors import SENSORS
from consensus.state.consent import effective_consent, read_choices
from contracts.lifecycle.registry import read_source
from contracts.vm import compile_contract
from tests.unit.contracts.privacy.hospital import DAY_MS, Hospital, Person, data_of, key_of

STEP_MS = 300_000


@pytest.fixture
def anna(hospital: Hospital) -> Person:
    """Registered with consents to care and demo."""
    return hospital.enrol("anna")


def newcomer(hospital: Hospital, name: str = "ben", role: str = "subject") -> Person:
    """Somebody who consented to nothing when he registered."""
    person, card = Person(name, role), hospital.card(name, role)
    hospital.must(person.identity, "identity", "register", *hospital.register_arguments(person, card, purposes=[]))
    person.handle = card.handle
    return person


def say(hospital: Hospital, person: Person, entry: str, *arguments: Any) -> Any:
    return hospital.must(person.identity, "consent", entry, person.handle, *arguments, *seen_now(hospital, entry))


def seen_now(hospital: Hospital, entry: str) -> list[int]:
    """A giving names the newest block that its person knew: here the head of the chain."""
    return [hospital.height] if entry == "give" else []


def allowed(hospital: Hospital, person: Person, purpose: str = "care", sensor: str = "depth") -> bool:
    told = hospital.view("consent", "allowed", person.handle, purpose, sensor)
    choices = read_choices(hospital.value("consent", b"of/" + person.handle))
    step = effective_consent(choices.get((purpose, sensor), ()), hospital.height)
    open_now = step is not None and step.from_ms <= hospital.time_ms
    if step is not None and step.until_ms:
        open_now = open_now and hospital.time_ms < step.until_ms
    assert not open_now or told, "what a robot reads from the state is never more than what the contract says"
    return bool(told)


def steps(hospital: Hospital, person: Person, purpose: str = "care", sensor: str = "depth") -> list[list[Any]]:
    return list(hospital.view("consent", "choices", person.handle)[purpose][sensor])


def code(hospital: Hospital, person: Person, entry: str, *arguments: Any) -> str:
    return hospital.send(person.identity, "consent", entry, person.handle, *arguments, *seen_now(hospital, entry)).code


def test_registering_gives_the_first_consents_to_the_depth_camera_alone(hospital: Hospital) -> None:
    anna = hospital.enrol("anna")
    assert not allowed(hospital, anna), "they hold from the next block on"
    hospital.block([])
    assert allowed(hospital, anna, "care")
    assert allowed(hospital, anna, "demo")
    assert not allowed(hospital, anna, "research")
    assert not any(allowed(hospital, anna, "care", sensor) for sensor in SENSORS if sensor != "depth")


@pytest.mark.parametrize("role", ["officer", "auditor"])
def test_who_is_never_recorded_has_nothing_to_consent_to(hospital: Hospital, role: str) -> None:
    person = hospital.enrol("olga", role)
    assert hospital.view("consent", "choices", person.handle) == {}
    assert code(hospital, person, "give", ["care"], ["depth"], 0, 0, 0) == "NOT_RECORDED"
    assert code(hospital, person, "withdraw", [], []) == "NOT_RECORDED"


def test_a_robot_cannot_consent_nor_anybody_for_another_nor_a_contract_in_between(
    hospital: Hospital, anna: Person
) -> None:
    assert code(hospital, hospital.robot, "give", ["care"], ["depth"], 0, 0, 0) == "NOT_RECORDED"
    for key in (hospital.robot.identity, hospital.registrar, hospital.admin, key_of("stranger")):
        receipt = hospital.send(key, "consent", "give", anna.handle, ["research"], ["rgb"], 0, 0, 0, 0)
        assert receipt.code == "NOT_THE_MEMBER"
    # `access` would call with the caller's key: only a transaction counts.
    source = '@export\ndef trick(handle: bytes):\n    call("consent", "give", handle, ["care"], ["rgb"], 0, 0, 0, 0)\n'
    hospital.contracts = {**hospital.contracts, "trick": compile_contract(source, "trick")}
    assert hospital.send(anna.identity, "trick", "trick", anna.handle).code == "CALL_INDIRECT"


def test_a_giving_holds_from_the_next_block_or_from_the_height_that_it_names(hospital: Hospital) -> None:
    ben = newcomer(hospital)
    receipt = say(hospital, ben, "give", ["care"], ["rgb", "depth"], 0, 0, 0)
    assert data_of(receipt, "given")["height"] == hospital.height + 1
    later = hospital.height + 5
    say(hospital, ben, "give", ["demo"], ["depth"], 0, 0, later)
    assert allowed(hospital, ben, "care", "rgb")
    assert allowed(hospital, ben, "care", "depth")
    while hospital.height < later:
        assert not allowed(hospital, ben, "demo")
        hospital.block([])
    assert allowed(hospital, ben, "demo")


@pytest.mark.parametrize("no", ["refuse", "withdraw"])
def test_a_no_holds_from_the_next_block_on(hospital: Hospital, anna: Person, no: str) -> None:
    hospital.block([])
    arguments: list[Any] = [["care"], ["depth"]]
    receipt = say(hospital, anna, no, *arguments)
    said_ms = hospital.time_ms
    hospital.block([])
    assert not allowed(hospital, anna)
    assert allowed(hospital, anna, "demo")
    (_, holds) = steps(hospital, anna)
    status = {"refuse": "refused", "withdraw": "withdrawn"}[no]
    assert holds == [receipt_height(receipt), status, said_ms, 0, 0, b""]


def receipt_height(receipt: Any) -> int:
    (event,) = receipt.events
    return int(data_of(receipt, event.name)["height"])


def test_a_robot_reads_a_no_as_soon_as_it_stands_there(hospital: Hospital, anna: Person) -> None:
    """The block that holds it proves it; by its height it holds from the next one."""
    hospital.block([])
    say(hospital, anna, "withdraw", [], [])
    choices = read_choices(hospital.value("consent", b"of/" + anna.handle))
    assert effective_consent(choices["care", "depth"], hospital.height) is None


def test_one_word_takes_everything_back(hospital: Hospital, anna: Person) -> None:
    say(hospital, anna, "give", ["care", "research"], ["rgb", "audio"], 0, 0, 0)
    say(hospital, anna, "give", ["teaching"], ["depth"], 0, 0, hospital.height + 50)
    say(hospital, anna, "withdraw", [], [])
    for _ in range(60):
        hospital.block([])
    assert not any(allowed(hospital, anna, purpose, sensor) for purpose in PURPOSES for sensor in SENSORS)


def test_a_no_ends_a_giving_that_is_still_to_come(hospital: Hospital) -> None:
    ben = newcomer(hospital)
    say(hospital, ben, "give", ["care"], ["depth"], 0, 0, hospital.height + 10)
    say(hospital, ben, "refuse", ["care"], [])
    for _ in range(20):
        hospital.block([])
    assert not allowed(hospital, ben)


def test_prolonging_leaves_no_gap_and_a_break_is_seen(hospital: Hospital) -> None:
    ben = newcomer(hospital)
    until = hospital.time_ms - hospital.time_ms % STEP_MS + 2 * STEP_MS
    say(hospital, ben, "give", ["care"], ["depth"], 0, until, 0)
    first_ms = hospital.time_ms
    say(hospital, ben, "give", ["care"], ["depth"], 0, until + STEP_MS, 0)
    assert allowed(hospital, ben)
    assert [step[2] for step in steps(hospital, ben)] == [first_ms, first_ms]
    say(hospital, ben, "withdraw", ["care"], ["depth"])
    say(hospital, ben, "give", ["care"], ["depth"], 0, 0, 0)
    hospital.block([])
    assert steps(hospital, ben)[-1][2] > first_ms, "a robot that slept through the break sees that there was one"


def test_a_consent_that_ran_out_is_not_prolonged_without_a_gap(hospital: Hospital) -> None:
    ben = newcomer(hospital)
    until = hospital.time_ms - hospital.time_ms % STEP_MS + STEP_MS
    say(hospital, ben, "give", ["care"], ["depth"], 0, until, 0)
    hospital.time_ms = until + 1
    say(hospital, ben, "give", ["care"], ["depth"], 0, 0, 0)
    assert steps(hospital, ben)[-1][2] == hospital.time_ms


def test_a_period_is_honoured(hospital: Hospital) -> None:
    ben = newcomer(hospital)
    begin = hospital.time_ms - hospital.time_ms % STEP_MS + STEP_MS
    say(hospital, ben, "give", ["care"], ["depth"], begin, begin + STEP_MS, 0)
    hospital.block([])
    assert not allowed(hospital, ben)
    hospital.time_ms = begin
    assert allowed(hospital, ben)
    hospital.time_ms = begin + STEP_MS
    assert not allowed(hospital, ben)


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ([["world-domination"], ["depth"], 0, 0, 0], "PURPOSE_UNKNOWN"),
        ([[b"care"], ["depth"], 0, 0, 0], "PURPOSE_UNKNOWN"),
        ([["care"] * 17, ["depth"], 0, 0, 0], "PURPOSES_TOO_MANY"),
        ([["care"], ["x-ray"], 0, 0, 0], "SENSOR_UNKNOWN"),
        ([["care"], [5], 0, 0, 0], "SENSOR_UNKNOWN"),
        ([["care"], ["depth"] * 5, 0, 0, 0], "SENSOR_UNKNOWN"),
        ([[], ["depth"], 0, 0, 0], "CHOICE_MISSING"),
        ([["care"], [], 0, 0, 0], "CHOICE_MISSING"),
        ([["care"], ["depth"], 1, 0, 0], "PERIOD_WRONG"),
        ([["care"], ["depth"], -STEP_MS, 0, 0], "PERIOD_WRONG"),
        ([["care"], ["depth"], 0, STEP_MS, 0], "PERIOD_WRONG"),
        ([["care"], ["depth"], 0, 2**60, 0], "PERIOD_WRONG"),
        ([["care"], ["depth"], 0, 0, 1], "HEIGHT_WRONG"),
        ([["care"], ["depth"], 0, 0, -1], "HEIGHT_WRONG"),
        ([["care"], ["depth"], 0, 0, 10**8], "HEIGHT_WRONG"),
    ],
)
def test_what_is_no_choice_is_refused(hospital: Hospital, anna: Person, arguments: list[Any], expected: str) -> None:
    assert code(hospital, anna, "give", *arguments) == expected
    assert code(hospital, anna, "refuse", *arguments[:2]) == expected or expected not in (
        "PURPOSE_UNKNOWN",
        "SENSOR_UNKNOWN",
    )


def test_a_consent_begins_in_a_later_block_than_its_own(hospital: Hospital, anna: Person) -> None:
    assert code(hospital, anna, "give", ["care"], ["depth"], 0, 0, hospital.height + 1) == "HEIGHT_WRONG"
    assert code(hospital, anna, "give", ["care"], ["depth"], 0, 0, hospital.height + 2) == "OK"


def test_taking_back_what_was_never_given_says_so_and_writes_no_choice(hospital: Hospital) -> None:
    ben = newcomer(hospital)
    assert data_of(say(hospital, ben, "withdraw", [], []), "withdrawn")["count"] == 0
    assert hospital.view("consent", "choices", ben.handle) == {}
    say(hospital, ben, "give", ["care"], ["depth", "rgb"], 0, 0, 0)
    assert data_of(say(hospital, ben, "withdraw", [], []), "withdrawn")["count"] == 2
    assert data_of(say(hospital, ben, "withdraw", [], []), "withdrawn")["count"] == 0


def test_who_leaves_or_is_revoked_leaves_no_choices(hospital: Hospital, anna: Person) -> None:
    ben = hospital.enrol("ben")
    for person in (anna, ben):
        say(hospital, person, "withdraw", [], [])
    hospital.must(anna.identity, "identity", "leave", anna.handle)
    hospital.must(hospital.registrar, "identity", "revoke", ben.handle)
    for person in (anna, ben):
        assert hospital.value("consent", b"of/" + person.handle) is None
        assert hospital.value("consent", b"own/" + person.handle) is None
        assert hospital.value("consent", b"said/" + person.handle) is None
        assert code(hospital, person, "give", ["care"], ["depth"], 0, 0, 0) == "MEMBER_NOT_ACTIVE"


def test_choices_stay_with_the_handle_when_keys_change(hospital: Hospital, anna: Person) -> None:
    new = Person("anna-new", handle=anna.handle)
    keys = {"spend": new.spend.public_key, "view": new.view.public_key, "sealing": new.sealing}
    signature = sign_rotation(
        new.identity, chain_id=hospital.chain_id, handle=anna.handle, member=anna.identity.public_key, **keys
    )
    before = hospital.view("consent", "choices", anna.handle)
    hospital.must(anna.identity, "identity", "rotate", anna.handle, new.identity.public_key, *keys.values(), signature)
    assert hospital.view("consent", "choices", anna.handle) == before
    assert code(hospital, anna, "withdraw", [], []) == "NOT_THE_MEMBER"
    say(hospital, new, "withdraw", [], [])


def test_two_numbers_tell_robots_that_something_changed(hospital: Hospital, anna: Person) -> None:
    def counts() -> tuple[int, int]:
        return hospital.value("identity", b"changes"), hospital.value("consent", b"changes")

    seen = [counts()]
    for act in (
        lambda: say(hospital, anna, "give", ["care"], ["rgb"], 0, 0, 0),
        lambda: say(hospital, anna, "refuse", ["demo"], []),
        lambda: say(hospital, anna, "withdraw", [], []),
        lambda: hospital.must(hospital.admin, "identity", "revoke", anna.handle),
    ):
        act()
        seen.append(counts())
    assert len(set(seen)) == len(seen)
    hospital.block([])
    assert counts() == seen[-1]


def test_a_full_row_costs_less_than_half_a_call_and_stays_bounded(hospital: Hospital) -> None:
    """Sixteen purposes are more than this network has: all it has, with all sensors, said over and over."""
    ben = newcomer(hospital)
    purposes, sensors = list(PURPOSES), sorted(SENSORS)
    for number in range(4):
        receipt = say(hospital, ben, "give", purposes, sensors, 0, 0, hospital.height + 2 + number)
        assert receipt.gas_used < CALL_GAS_MAX // 2
    for entry, named in (("refuse", (purposes, sensors)), ("withdraw", (purposes, sensors)), ("withdraw", ([], []))):
        last = say(hospital, ben, entry, *named)
        assert last.gas_used < CALL_GAS_MAX // 2
    row = hospital.view("consent", "choices", ben.handle)
    assert max(len(found) for by_sensor in row.values() for found in by_sensor.values()) <= 2


def test_the_contract_has_the_published_sensors() -> None:
    assert f"SENSORS = {tuple(sorted(SENSORS))!r}".replace("'", '"') in read_source("consent")


def test_nothing_of_a_tag_or_a_visit_is_in_a_row(hospital: Hospital, anna: Person) -> None:
    """A row is found by the handle, which is random; no owner key and no time finer than a block's stands in it."""
    hospital.time_ms += DAY_MS
    say(hospital, anna, "give", ["care"], ["rgb"], 0, 0, 0)
    row = hospital.value("consent", b"of/" + anna.handle)
    found = [step for by_sensor in row.values() for steps in by_sensor.values() for step in steps]
    assert {type(item) for step in found for item in step[:-1]} == {int, str}
    assert {step[-1] for step in found} == {b""}, "nobody acts for her: there is no mandate to be named"

"""The medication cabinet: two nurses' signatures, each over this very request, or nothing leaves it."""

from __future__ import annotations

import pytest

from contracts.kit import Chain, Contract

TAG = "medication/confirm"
PATIENT = bytes(range(32))


@pytest.fixture
def cabinet(chain: Chain) -> Contract:
    """A cabinet with twelve ampoules, the nurses Ada and Ben, and Carl who is no nurse any more."""
    cabinet = chain.deploy("medication.py")
    cabinet.call("set_up", caller="pharmacist")
    for nurse in ("ada", "ben", "carl"):
        cabinet.call("name_nurse", chain.caller(nurse).key, True, caller="pharmacist")
    cabinet.call("name_nurse", chain.caller("carl").key, False, caller="pharmacist")
    assert cabinet.call("fill", "morphine", 12, caller="pharmacist") == 12
    return cabinet


def sign(chain: Chain, cabinet: Contract, nurse: str, number: int) -> bytes:
    return chain.caller(nurse).sign(TAG, cabinet.view("to_sign", number))


def test_two_nurses_take_a_dose(chain: Chain, cabinet: Contract) -> None:
    number = cabinet.call("request", "morphine", 2, PATIENT, caller="ada")
    cabinet.call("hand_over", number, sign(chain, cabinet, "ben", number), caller="ada")
    assert cabinet.view("stock", "morphine") == 10
    ben = chain.caller("ben").key
    assert cabinet.events("handed_over") == [{"number": 1, "drug": "morphine", "units": 2, "second": ben}]
    assert cabinet.view("handed_over", number)["second"] == ben


def test_one_nurse_alone_takes_nothing(chain: Chain, cabinet: Contract) -> None:
    number = cabinet.call("request", "morphine", 2, PATIENT, caller="ada")
    own = sign(chain, cabinet, "ada", number)
    cabinet.expect_failure("SAME_NURSE", "hand_over", number, own, caller="ada")
    cabinet.expect_failure("SIGNATURE_WRONG", "hand_over", number, bytes(65), caller="ada")
    assert cabinet.view("stock", "morphine") == 12


def test_who_is_no_nurse_confirms_nothing(chain: Chain, cabinet: Contract) -> None:
    number = cabinet.call("request", "morphine", 2, PATIENT, caller="ada")
    for stranger in ("carl", "pharmacist"):
        signature = sign(chain, cabinet, stranger, number)
        cabinet.expect_failure("NOT_NURSE", "hand_over", number, signature, caller="ada")
    cabinet.expect_failure("NOT_NURSE", "request", "morphine", 2, PATIENT, caller="carl")


def test_a_signature_is_for_one_request(chain: Chain, cabinet: Contract) -> None:
    first = cabinet.call("request", "morphine", 2, PATIENT, caller="ada")
    second = cabinet.call("request", "morphine", 9, PATIENT, caller="ada")
    signature = sign(chain, cabinet, "ben", first)
    cabinet.expect_failure("NOT_NURSE", "hand_over", second, signature, caller="ada")
    cabinet.call("hand_over", first, signature, caller="ada")
    cabinet.expect_failure("HANDED_OVER", "hand_over", first, signature, caller="ada")
    cabinet.expect_failure("NOT_YOURS", "hand_over", second, sign(chain, cabinet, "ada", second), caller="ben")


def test_a_request_grows_old(chain: Chain, cabinet: Contract) -> None:
    number = cabinet.call("request", "morphine", 2, PATIENT, caller="ada")
    signature = sign(chain, cabinet, "ben", number)
    chain.advance(minutes=11)
    cabinet.expect_failure("REQUEST_OLD", "hand_over", number, signature, caller="ada")


def test_the_cabinet_gives_what_it_has(chain: Chain, cabinet: Contract) -> None:
    cabinet.expect_failure("STOCK_TOO_LOW", "request", "morphine", 13, PATIENT, caller="ada")
    numbers = [cabinet.call("request", "morphine", 8, PATIENT, caller="ada") for _ in range(2)]
    signatures = [sign(chain, cabinet, "ben", number) for number in numbers]
    cabinet.call("hand_over", numbers[0], signatures[0], caller="ada")
    cabinet.expect_failure("STOCK_TOO_LOW", "hand_over", numbers[1], signatures[1], caller="ada")


def test_only_the_pharmacist_fills_and_names(cabinet: Contract) -> None:
    cabinet.expect_failure("SET_UP_ALREADY", "set_up", caller="ada")
    cabinet.expect_failure("NOT_PHARMACIST", "fill", "morphine", 1, caller="ada")
    cabinet.expect_failure("NOT_PHARMACIST", "name_nurse", bytes(33), True, caller="ada")
    cabinet.expect_failure("KEY_WRONG", "name_nurse", b"short", True, caller="pharmacist")
    cabinet.expect_failure("FILL_WRONG", "fill", "morphine", 0, caller="pharmacist")


def test_what_is_asked_for_has_a_form(cabinet: Contract) -> None:
    cabinet.expect_failure("UNITS_WRONG", "request", "morphine", 21, PATIENT, caller="ada")
    cabinet.expect_failure("PATIENT_WRONG", "request", "morphine", 1, b"a name", caller="ada")
    cabinet.expect_failure("REQUEST_UNKNOWN", "hand_over", 7, bytes(65), caller="ada")

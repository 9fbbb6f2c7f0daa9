"""One catalogue of texts: both languages say the same things, and every text that the code asks for is there."""

from __future__ import annotations

import ast
import string
from pathlib import Path

import click
import pytest

from clients.wallet import language
from clients.wallet.language import ONE, OTHER, Form, describe_error, find_language, load, section, text
from consensus.errors import CATALOGUE, BlockRobotError
from consensus.records.purposes import PURPOSES
from consensus.records.sensors import SENSORS

WALLET = Path(language.__file__).parent


def own_keys(name: str) -> set[str]:
    return {key for key in load(name) if not key.startswith("errors.")}


def names_in(form: Form) -> set[str]:
    texts = [form] if isinstance(form, str) else list(form.values())
    return {field for one in texts for _, field, _, _ in string.Formatter().parse(one) if field is not None}


def test_both_languages_have_the_same_texts() -> None:
    assert own_keys("en") == own_keys("pt")


def test_a_text_has_the_same_values_and_the_same_forms_in_both_languages() -> None:
    for key in own_keys("en"):
        english, portuguese = load("en")[key], load("pt")[key]
        assert isinstance(english, str) == isinstance(portuguese, str), key
        assert names_in(english) == names_in(portuguese), key


def test_no_text_is_empty_or_begins_or_ends_with_a_blank_line() -> None:
    for name in language.LANGUAGES:
        for key, form in load(name).items():
            for one in [form] if isinstance(form, str) else form.values():
                assert one.strip(), key
                assert one == one.strip("\n"), key


def asked_for() -> dict[str, str]:
    """Every key that is written in the wallet's code as `text("...")`, and where."""
    found = {}
    for path in WALLET.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "text" and node.args:
                for part in ast.walk(node.args[0]):
                    if isinstance(part, ast.JoinedStr):
                        break
                    if isinstance(part, ast.Constant) and isinstance(part.value, str):
                        found[part.value] = f"{path.name}:{node.lineno}"
    return found


def test_every_text_that_the_code_asks_for_is_there() -> None:
    missing = {key: place for key, place in asked_for().items() if key not in load("en")}
    assert not missing


def test_a_code_that_has_a_translation_is_in_the_catalogue_of_errors() -> None:
    for key in load("pt"):
        if key.startswith("errors."):
            _, code, what = key.split(".")
            assert code in CATALOGUE
            assert what in {"meaning", "next_step"}


def test_purposes_and_sensors_are_those_that_are_published() -> None:
    assert section("purpose", "en") == PURPOSES
    assert section("sensor", "en") == SENSORS


MET_BY_PATIENTS = {code for code in CATALOGUE if code.startswith(("WALLET_", "WORDS_", "VOUCHER_"))} | {
    "CALL_REFUSED",
    "CLIP_ERASED",
    "ERASURE_NOT_CONFIRMED",
    "FILE_UNUSABLE",
    "GENESIS_INVALID",
    "HANDLE_TAKEN",
    "MEMBER_NO_MORE",
    "NODE_UNREACHABLE",
    "NOT_FOUND",
    "NOT_REGISTERED",
    "PROOF_INVALID",
    "RENDITION_CORRUPTED",
    "SESSION_REFUSED",
    "TRANSACTION_NOT_FINAL_IN_TIME",
}


@pytest.mark.parametrize("code", sorted(MET_BY_PATIENTS))
def test_what_a_patient_meets_is_told_with_its_next_step_in_portuguese(code: str) -> None:
    detail, next_step = describe_error(BlockRobotError(code), "pt")
    assert detail == load("pt")[f"errors.{code}.meaning"] != CATALOGUE[code].meaning
    assert next_step == load("pt")[f"errors.{code}.next_step"] != CATALOGUE[code].next_step


@pytest.mark.parametrize(
    ("environment", "expected"),
    [
        ({}, "en"),
        ({"LANG": "pt_PT.UTF-8"}, "pt"),
        ({"LANG": "pt_PT.UTF-8", "LC_ALL": "C"}, "en"),
        ({"LANG": "en_GB.UTF-8", "LC_MESSAGES": "pt_BR"}, "pt"),
        ({"LANG": "de_DE.UTF-8"}, "en"),
        ({"LANG": "en_GB", "BLOCKROBOT_LANGUAGE": "pt-PT"}, "pt"),
        ({"LANG": "pt_PT", "BLOCKROBOT_LANGUAGE": "en"}, "en"),
        ({"LANG": "pt_PT", "BLOCKROBOT_LANGUAGE": "klingon"}, "en"),
    ],
)
def test_the_language_is_the_one_that_is_named_else_that_of_the_locale(
    environment: dict[str, str], expected: str
) -> None:
    assert find_language(environment) == expected


def test_what_the_command_line_says_goes_before_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BLOCKROBOT_LANGUAGE", "en")
    with click.Context(click.Command("wallet")) as context:
        language.choose_language(context, "pt")
        assert text("records.none") == load("pt")["records.none"]
    assert text("records.none") == load("en")["records.none"]


def test_a_plural_form_is_chosen_by_the_count_and_values_are_put_in(monkeypatch: pytest.MonkeyPatch) -> None:
    forms = {"a.pictures": {ONE: "{count} picture", OTHER: "{count} pictures"}}
    monkeypatch.setattr(language, "load", lambda _name: forms)
    said = [text("a.pictures", language="en", count=count) for count in (0, 1, 2)]
    assert said == ["0 pictures", "1 picture", "2 pictures"]


def test_what_a_language_lacks_is_said_in_english(monkeypatch: pytest.MonkeyPatch) -> None:
    tables = {"en": {"page.title": "Yours"}, "pt": {}}
    monkeypatch.setattr(language, "load", lambda name: tables[name])
    assert text("page.title", language="pt") == "Yours"
    assert section("page", "pt") == {"title": "Yours"}


def test_an_error_keeps_its_particulars_beside_its_translated_meaning(monkeypatch: pytest.MonkeyPatch) -> None:
    table = {"errors.NOT_FOUND.meaning": "Não existe.", "errors.NOT_FOUND.next_step": "Verifique o nome."}
    monkeypatch.setattr(language, "load", lambda name: table if name == "pt" else {})
    assert describe_error(BlockRobotError("NOT_FOUND"), "pt") == ("Não existe.", "Verifique o nome.")
    assert describe_error(BlockRobotError("NOT_FOUND", "No visit 02ab."), "pt")[0] == "Não existe. (No visit 02ab.)"
    english = BlockRobotError("NOT_FOUND", "No visit 02ab.")
    assert describe_error(english, "en") == ("No visit 02ab.", english.next_step)

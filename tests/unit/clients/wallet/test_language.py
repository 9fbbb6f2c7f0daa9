"""One catalogue of texts: both languages say the same things, and every text that the code asks for is there."""

from __future__ import annotations

import ast
import re
import string
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import click
import pytest

from clients.wallet import text_catalogue
from clients.wallet.ledger import id_prefix
from clients.wallet.presentation import translations
from clients.wallet.presentation.translations import WrongUsage, describe_error, find_language, section, text
from clients.wallet.text_catalogue import ONE, OTHER, Form, load, refusal
from consensus.contract_refusals import NEXT_STEPS
from consensus.errors import CATALOGUE, BlockRobotError
from consensus.rights.purposes import PURPOSES
from consensus.rights.sensors import SENSORS

ENGLISH_ONLY = frozenset(
    re.findall(
        r"\w+",
        """
        the of is are was were be been being you your they them their she his its it this that these those with without and
        not does did have has had can cannot will would should which who whom what when where there here from by on before
        after until within into only also so such every each other some any nobody nothing something because while than then
        """,
    )
)
"""Words of English sentences that no Portuguese sentence has."""
WALLET = Path(translations.__file__).parents[1]


def own_keys(name: str) -> set[str]:
    return {key for key in load(name) if not key.startswith(("errors.", "refusals.", "help."))}


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


def test_portuguese_calls_only_guardians_guardians() -> None:
    """Guardians hold parts of the 24 words, custodians keep recordings: one word for both would confuse them."""
    guardians = {key for key in own_keys("en") if "guardian" in str(load("en")[key]).casefold()}
    called = {key for key in own_keys("pt") if "guardi" in str(load("pt")[key]).casefold()}
    assert called - guardians == set()


def words_of(form: Form) -> set[str]:
    """The words of a text, without its fields, and without what is typed: commands and options stay as they are."""
    texts = [form] if isinstance(form, str) else list(form.values())
    said = (re.sub(r"`[^`]*`|\{\w+\}|blockrobot [^.;:\n]*|--[\w-]+", " ", one) for one in texts)
    return {word for one in said for word in re.findall(r"[^\W\d_]+", one.casefold())}


def test_no_portuguese_text_has_an_english_clause() -> None:
    assert words_of("Pediu isto (node-1 does not answer)") & ENGLISH_ONLY == {"does", "not"}
    found = {key: words_of(form) & ENGLISH_ONLY for key, form in load("pt").items()}
    assert {key: words for key, words in found.items() if words} == {}


@pytest.mark.parametrize("code", sorted(CATALOGUE))
def test_particulars_in_english_are_never_put_into_a_portuguese_sentence_without_saying_so(code: str) -> None:
    english = "node-1 does not answer"
    told = describe_error(BlockRobotError(code, english), "pt")[0]
    assert told == english or told.endswith(f"(pormenor, em inglês: {english})")


def test_to_say_no_needs_no_reason_in_either_language() -> None:
    """`Um não dispensa motivos` says as well that a no cannot do without reasons."""
    assert "needs no reason" in text("page.consent.lead", language="en")
    assert "não tem de dar motivos" in text("page.consent.lead", language="pt")
    assert not [key for key, form in load("pt").items() if "não dispensa" in str(form)]


def test_no_text_is_empty_or_begins_or_ends_with_a_blank_line() -> None:
    for name in translations.LANGUAGES:
        for key, form in load(name).items():
            for one in [form] if isinstance(form, str) else form.values():
                assert one.strip(), key
                assert one == one.strip("\n"), key


def asked_for() -> dict[str, str]:
    """Every key that is written in the wallet's code as `text("...")`, or by what a refusal is made, and where."""
    found = {}
    makers = {"text": (0, ""), "refusal": (1, "because."), "WrongUsage": (0, "usage.")}
    for path in WALLET.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not (isinstance(node, ast.Call) and isinstance(node.func, ast.Name)):
                continue
            place, start = makers.get(node.func.id, (len(node.args), ""))
            if place < len(node.args):
                for part in ast.walk(node.args[place]):
                    if isinstance(part, ast.JoinedStr):
                        break
                    if isinstance(part, ast.Constant) and isinstance(part.value, str):
                        found[start + part.value] = f"{path.name}:{node.lineno}"
    return found


def test_every_text_that_the_code_asks_for_is_there() -> None:
    missing = {key: place for key, place in asked_for().items() if key not in load("en")}
    assert not missing


def test_no_sentence_of_a_refusal_is_kept_that_nobody_says() -> None:
    asked = asked_for() | dict.fromkeys(
        f"because.{sentence}.{thing.one}"
        for sentence in ("short", "missing", "several")
        for thing in (
            id_prefix.RECORD,
            id_prefix.VISIT,
            id_prefix.GRANT,
            id_prefix.BREACH,
            id_prefix.PROPOSAL,
            id_prefix.MANDATE,
        )
    )
    trouble = ("took_nothing", "may_have", "may_still_have", "gave_nothing")
    asked |= dict.fromkeys((f"because.keyring_{each}" for each in trouble), "system_keyring.py")
    asked |= dict.fromkeys(("because.guardian_set", "because.guardian_set_differs"), "shares.py")
    assert {key for key in load("en") if key.startswith(("because.", "usage."))} == {
        key for key in asked if key.startswith(("because.", "usage."))
    }


def test_what_a_patient_uses_wrongly_is_never_worded_in_the_code() -> None:
    worded = [
        f"{path.name}:{node.lineno}"
        for path in WALLET.rglob("*.py")
        if path.name != "translations.py"
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and node.func.attr in {"UsageError", "BadParameter", "ClickException"}
    ]
    assert worded == []


def test_a_refusal_with_a_sentence_of_the_catalogue_says_it_in_the_language_with_its_values() -> None:
    error = refusal("WALLET_PASSPHRASE_WRONG", "passphrase_left", count=4)
    assert error.detail == "That is not the passphrase. 4 tries are left.", "what a program is told"
    assert describe_error(error, "en")[0] == error.detail
    assert describe_error(error, "pt")[0] == "Essa não é a frase-passe. Restam 4 tentativas."
    one = refusal("WALLET_PASSPHRASE_WRONG", "passphrase_left", count=1)
    assert describe_error(one, "pt")[0] == "Essa não é a frase-passe. Resta 1 tentativa."


def test_what_was_put_before_a_refusals_sentence_stays_before_it_in_every_language() -> None:
    error = refusal("SHARE_WORD_UNKNOWN", "guardian_word", number=7)
    named = BlockRobotError(error.code, f"sheet.txt: {error.detail}", **error.context)
    assert describe_error(named, "pt")[0] == "sheet.txt: A palavra 7 não está na lista."
    other = BlockRobotError(error.code, "Something else altogether.", **error.context)
    assert describe_error(other, "pt")[0].endswith("(pormenor, em inglês: Something else altogether.)")


def test_wrong_usage_is_told_to_people_in_their_language_and_to_programs_in_english(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("BLOCKROBOT_LANGUAGE", "pt")
    wrong = WrongUsage("no_time", given="soon")
    assert (
        wrong.format_message() == "'soon' is no time: write 2027-01-31, 2027-01-31T18:00, or from now on +30d or -12h."
    )
    wrong.show()
    assert "'soon' não é um momento: escreva 2027-01-31" in capsys.readouterr().err
    assert wrong.exit_code == click.UsageError("").exit_code


def test_a_code_that_has_a_translation_is_in_the_catalogue_of_errors() -> None:
    for key in load("pt"):
        if key.startswith("errors."):
            _, code, what = key.split(".")
            assert code in CATALOGUE
            assert what in {"meaning", "next_step"}


def test_purposes_and_sensors_are_those_that_are_published() -> None:
    assert section("purpose", "en") == PURPOSES
    assert section("sensor", "en") == SENSORS


PROJECT = WALLET.parents[1]
OF_OTHERS = {
    # Officers
    "BREACH_NOT_FOUND",
    "CORRECTION_UNPROVEN",
    "MANDATE_PAPERS_OTHER",
    "PROPOSAL_NOT_FOUND",
    "SPAN_EMPTY",
    "SPAN_INVALID",
    "SPAN_TOO_FULL",
    # Those who govern the network
    "BACKGROUND_INVALID",
    "GOVERNANCE_APPROVED_ALREADY",
    "GOVERNANCE_CONTRACT_REFUSED",
    "GOVERNANCE_NOT_ADMIN",
    "GOVERNANCE_PROPOSAL_CLOSED",
    "GOVERNANCE_REFUSED",
    "GOVERNANCE_SETTING_REFUSED",
    "GOVERNANCE_WOULD_STOP_CHAIN",
    # Robots
    "FRAME_INVALID",
    "UPLOAD_HASH_MISMATCH",
    "UPLOAD_INVALID",
}
"""Codes in the code that a wallet runs which no patient meets: they stay English."""
REFUSALS_OF_OTHERS = {
    # Officers
    "NOT_AN_OFFICER",
    "BREACH_NOT_ASSESSED",
    "BREACH_NOT_NOTIFIED",
    "BREACH_CLOSED",
    "BREACH_UNKNOWN",
    "NOTIFIED_ALREADY",
    "RISK_LOWERED",
    "DELAY_UNEXPLAINED",
    "RECORDS_LEFT",
    "OFFICER_THE_SAME",
    "OFFICER_GONE",
    "NOT_OF_THE_TWO",
    "NOT_APPROVED",
    "MANDATE_EXISTS",
    "OFFICER_CONCERNED",
    "REPRESENTATIVE_WRONG",
    "REPRESENTED_WRONG",
    "PROPOSAL_DECIDED",
    "PROPOSAL_LAPSED",
    "SPAN_WRONG",
    "VISITS_TOO_MANY",
    # Admins
    "ROBOT_UNKNOWN",
    "NOT_OF_THE_ORGANISATION",
    "EMPTY_FRAME_UNKNOWN",
    "EMPTY_FRAMES_TOO_MANY",
    # Those who write programs
    "ARGUMENTS_INVALID",
    "ENTRY_UNKNOWN",
    "CALL_INDIRECT",
}
"""What a contract refuses to others than patients: the next step stays English."""


def codes_in_the_code() -> set[str]:
    """Every code of the catalogue that stands as a text in the code which runs in a wallet, an officer's too."""
    found = set()
    for folder in ("clients/wallet", "clients/officer", "clients/sdk", "pages"):
        for path in (PROJECT / folder).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value in CATALOGUE:
                    found.add(node.value)
    return found


TRANSLATED = {key.split(".")[1] for key in load("pt") if key.startswith("errors.")}


def test_what_a_wallet_can_refuse_is_translated_or_known_to_stay_english() -> None:
    assert codes_in_the_code() - TRANSLATED == OF_OTHERS


def test_what_a_contract_refuses_a_patient_has_its_next_step_in_portuguese() -> None:
    told = section("refusals", "pt")
    assert set(NEXT_STEPS) - set(told) == REFUSALS_OF_OTHERS
    assert set(told) <= set(NEXT_STEPS)
    for code, step in told.items():
        for error in (
            BlockRobotError("CALL_REFUSED", "Some sentence.", contract_code=code),
            BlockRobotError("CALL_REFUSED", f"{code}: some sentence."),
        ):
            assert describe_error(error, "pt")[1] == step != NEXT_STEPS[code]
            assert describe_error(error, "en")[1] == NEXT_STEPS[code]


def test_a_refusal_without_a_translated_step_keeps_the_one_that_says_more() -> None:
    error = BlockRobotError("CALL_REFUSED", "Some sentence.", contract_code="OFFICER_THE_SAME")
    assert describe_error(error, "pt")[1] == NEXT_STEPS["OFFICER_THE_SAME"]


@pytest.mark.parametrize("code", sorted(TRANSLATED))
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
        translations.choose_language(context, "pt")
        assert text("records.none") == load("pt")["records.none"]
    assert text("records.none") == load("en")["records.none"]


def put_catalogue(monkeypatch: pytest.MonkeyPatch, load_stand_in: Callable[[str], Mapping[str, Any]]) -> None:
    for module in (text_catalogue, translations):
        monkeypatch.setattr(module, "load", load_stand_in)


def test_a_plural_form_is_chosen_by_the_count_and_values_are_put_in(monkeypatch: pytest.MonkeyPatch) -> None:
    forms = {"a.pictures": {ONE: "{count} picture", OTHER: "{count} pictures"}}
    put_catalogue(monkeypatch, lambda _name: forms)
    said = [text("a.pictures", language="en", count=count) for count in (0, 1, 2)]
    assert said == ["0 pictures", "1 picture", "2 pictures"]


def test_what_a_language_lacks_is_said_in_english(monkeypatch: pytest.MonkeyPatch) -> None:
    tables = {"en": {"page.title": "Yours"}, "pt": {}}
    put_catalogue(monkeypatch, lambda name: tables[name])
    assert text("page.title", language="pt") == "Yours"
    assert section("page", "pt") == {"title": "Yours"}


def test_an_error_keeps_its_particulars_beside_its_translated_meaning(monkeypatch: pytest.MonkeyPatch) -> None:
    table = {"errors.NOT_FOUND.meaning": "Não existe.", "errors.NOT_FOUND.next_step": "Verifique o nome."}
    table["ask.particulars"] = "{meaning} (em inglês: {detail})"
    put_catalogue(monkeypatch, lambda name: table if name == "pt" else {})
    assert describe_error(BlockRobotError("NOT_FOUND"), "pt") == ("Não existe.", "Verifique o nome.")
    assert (
        describe_error(BlockRobotError("NOT_FOUND", "No visit 02ab."), "pt")[0]
        == "Não existe. (em inglês: No visit 02ab.)"
    )
    english = BlockRobotError("NOT_FOUND", "No visit 02ab.")
    assert describe_error(english, "en") == ("No visit 02ab.", english.next_step)

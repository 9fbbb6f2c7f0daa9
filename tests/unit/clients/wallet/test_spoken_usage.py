"""Wrong usage in Portuguese: all of it, by whichever side it stands; English and JSON are what click makes of it."""

from __future__ import annotations

import json
import re
from typing import Any

import click
import pytest
from click.testing import CliRunner, Result

from clients.wallet.commands.audit_commands import audit
from clients.wallet.text_catalogue import load
from network.cli.main import main

ENGLISH = re.compile(
    r"\b(Usage|Try|Error|for help|Missing|Invalid|No such|Got|Option|Argument|requires|takes|does|is)\b"
)


def run(*arguments: str, language: str = "pt") -> Result:
    return CliRunner(env={"LANG": "C.UTF-8", "BLOCKROBOT_LANGUAGE": language}).invoke(main, ["wallet", *arguments])


WRONG = [
    (("erase", "--bogus"), "Não há opção '--bogus'."),
    (("erase", "--frame", "1"), "Não há opção '--frame'. Queria dizer '--frames'?"),
    (("--bogus",), "Não há opção '--bogus'."),
    (("recrods",), "Não há comando 'recrods'. Queria dizer 'records'?"),
    (("xyzzy",), "Não há comando 'xyzzy'."),
    (("consent", "xyzzy"), "Não há comando 'xyzzy'."),
    (("register",), "Falta o argumento 'CÓDIGO'."),
    (("share", "ab"), "Falta a opção '--with'."),
    (("share", "ab", "--with"), "A opção '--with' leva um valor."),
    (("erase", "--all=1"), "A opção '--all' não leva valor."),
    (("audit", "5cc7", "6dd8"), "A mais na linha de comandos: 5cc7 6dd8"),
    (("audit", "5cc7"), "A mais na linha de comandos: 5cc7"),
    (
        ("share", "ab", "--with", "x", "--purpose", "care", "--until", "amanhã"),
        "'amanhã' não é um momento: escreva 2027-01-31, 2027-01-31T18:00 ou, a partir de agora, +30d ou -12h.",
    ),
    (("--language", "klingon", "audit"), "Valor inválido para '--language': 'klingon' não é nenhum de 'en', 'pt'."),
    (("rotate", "--over-minutes", "muitos"), "Valor inválido para '--over-minutes': 'muitos' não é um número válido."),
    (
        ("rotate", "--over-minutes", "99999"),
        "Valor inválido para '--over-minutes': 99999 não está no intervalo 0<=x<=10080.",
    ),
]


@pytest.mark.parametrize(("arguments", "said"), WRONG)
def test_wrong_usage_is_told_in_portuguese_from_the_first_word_to_the_last(
    arguments: tuple[str, ...], said: str
) -> None:
    wrong = run(*arguments)
    assert wrong.exit_code == 2
    told, _, error = wrong.stderr.rpartition("Erro: ")
    assert error.startswith(said)
    if "Usage: " in run(*arguments, language="en").stderr:  # click knows not of every one where it stood
        usage, hint, _ = told.splitlines()
        assert usage.startswith("Utilização: ")
        assert re.fullmatch(r"Experimente 'main wallet[a-z ]* --help' para obter ajuda\.", hint)
    assert ENGLISH.search(wrong.stderr) is None


@pytest.mark.parametrize(("arguments", "said"), WRONG)
def test_in_english_and_in_json_wrong_usage_is_told_as_click_tells_it(arguments: tuple[str, ...], said: str) -> None:
    english, answer = run(*arguments, language="en"), run(*arguments, "--json", language="pt")
    assert said not in english.stderr + answer.stdout
    assert (english.exit_code, answer.exit_code) == (2, 2)
    detail = json.loads(answer.stdout)["error"]["detail"]
    if arguments not in {("--bogus",), ("share", "ab", "--with")}:  # there --json is taken for something else
        assert english.stderr.endswith(f"Error: {detail}\n")


def test_what_the_wallet_says_itself_of_wrong_usage_stands_between_portuguese_words() -> None:
    wrong = run("erase")
    assert wrong.exit_code == 2
    assert wrong.stderr.endswith(f"Erro: {load('pt')['usage.erase_what']}\n")
    assert ENGLISH.search(wrong.stderr) is None
    assert f"\nError: {load('en')['usage.erase_what']}\n" in run("erase", language="en").stderr


def test_the_language_that_the_command_line_names_is_that_of_what_was_wrong_in_it() -> None:
    for arguments in (("erase", "--bogus"), ("--bogus",), ("erase",)):
        assert run("--language", "pt", *arguments, language="en").stderr.startswith("Utilização: ")
        assert run("--language", "en", *arguments, language="pt").stderr.startswith("Usage: ")


@pytest.mark.parametrize("ending", [click.Abort, KeyboardInterrupt, EOFError])
def test_who_stops_a_command_is_told_so_in_her_language(
    ending: type[BaseException], monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(_: Any) -> None:
        raise ending

    monkeypatch.setattr(audit, "invoke", stop)
    told, english = run("audit"), run("audit", language="en")
    assert (told.exit_code, english.exit_code) == (1, 1)
    assert told.stderr.strip() == "Interrompido."
    assert english.stderr.strip() == "Aborted!"

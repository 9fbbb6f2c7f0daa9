"""Help in Portuguese: every command, option and word of the wallet's help, and English that nothing changes."""

from __future__ import annotations

import gettext
import io
import os
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import click
import pytest
from babel.messages.mofile import read_mo
from babel.messages.pofile import read_po
from click.shell_completion import CompletionItem, ShellComplete
from click.testing import CliRunner

from clients.wallet.cli.main import wallet
from clients.wallet.cli.translated_help import EXAMPLE, click_speaks, paragraphs, placeholders
from clients.wallet.presentation.translations import section
from clients.wallet.text_catalogue import FOLDER, load
from network.cli.main import main

PREFIX = "help."
BLOCKROBOT = Path(sys.executable).with_name("blockrobot")


def commands(
    command: click.Command = wallet, path: tuple[str, ...] = ("wallet",)
) -> Iterator[tuple[str, click.Command]]:
    """Yield every command of the wallet by the words that call it, hidden ones too."""
    yield " ".join(path), command
    if isinstance(command, click.Group):
        context = click.Context(command)
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            assert below is not None
            yield from commands(below, (*path, name))


EVERY = dict(commands())


def english_of(command: click.Command) -> set[str]:
    """Return everything that a command's help says of its own, and the words in it that stand for something."""
    context = click.Context(command, help_option_names=["-h", "--help"])
    told = paragraphs(command.help or "")
    examples = [part for part in told if part.startswith(EXAMPLE)]
    said, shown = set(told) - set(examples), [*examples, *command.collect_usage_pieces(context)]
    for param in command.params:
        if isinstance(param, click.Option):
            record = param.get_help_record(context)
            assert record is not None, "no option of the wallet is hidden"
            shown.append(record[0])
            said.update(paragraphs(param.help or "") if param.help else ())
    return said | set(placeholders(" ".join(shown))) | ({EXAMPLE} if examples else set())


def helped(*arguments: str, **environment: str | None) -> str:
    told = CliRunner(env={"LANG": "C.UTF-8", **environment}).invoke(main, ["wallet", *arguments, "--help"])
    assert told.exit_code == 0, told.output
    return told.output


def one_line(told: str) -> str:
    return " ".join(told.split())


@pytest.mark.parametrize("words", EVERY)
def test_everything_that_a_commands_help_says_is_in_portuguese(words: str) -> None:
    missing = english_of(EVERY[words]) - set(section("help", "pt"))
    assert not missing, "pt.toml lacks these, or the English was changed since"


def test_no_translation_is_kept_of_what_no_help_says() -> None:
    said = set().union(*map(english_of, EVERY.values()))
    assert {key.removeprefix(PREFIX) for key in load("pt") if key.startswith(PREFIX)} == said


def test_all_commands_are_looked_at() -> None:
    assert len(EVERY) > 35
    assert {"wallet consent give", "wallet guardians recover", "wallet keyring store", "wallet notice"} <= set(EVERY)


@pytest.mark.parametrize("words", EVERY)
def test_a_translation_names_the_options_and_commands_that_the_english_names(words: str) -> None:
    told = section("help", "pt")
    for english in english_of(EVERY[words]):
        named = {word.strip("`().,:;") for word in english.split() if word.startswith(("--", "`", "(--"))}
        assert {name for name in named if name not in str(told[english])} == set(), english


@pytest.mark.parametrize("words", EVERY)
def test_help_in_portuguese_shows_the_options_and_commands_of_the_english_one(words: str) -> None:
    arguments = words.split()[1:]
    english, told = helped(*arguments), helped(*arguments, LANG="pt_PT.UTF-8")

    def names(page: str, heading: str) -> list[str]:
        # click keeps the help option as the first context of this process spelt it
        rows = page[page.index(f"{heading}:\n") :].replace("-h, ", "").splitlines()
        return [row.split()[0].rstrip(",") for row in rows if row.startswith("  ") and row[2:3].strip()]

    assert names(told, "Opções") == names(english, "Options") != []
    for said in ("Usage", "Options:", "Commands:", "Example", "default:", "required", "message", "[OPTIONS]", "TEXT "):
        assert said not in told
    assert told.startswith("Utilização: ")


def test_words_of_click_and_what_stands_for_something_are_said_in_portuguese() -> None:
    told = one_line(helped("share", LANG="pt_PT.UTF-8"))
    for said in (
        "wallet share [OPÇÕES] [GRAVAÇÃO]...",
        "Partilha gravações de um encontro com um membro do pessoal",
        'Exemplo: blockrobot wallet share --visit 02ab34cd --with IDENTIFICADOR --as "Dr Weber" --purpose care',
        "Opções: --visit TEXTO Um encontro inteiro, pelo começo do seu nome; pode indicar vários.",
        "com que já partilhou. [obrigatório]",
        "--help Mostra esta mensagem e termina.",
    ):
        assert said in told
    told = one_line(helped("rotate", LANG="pt_PT.UTF-8"))
    assert "--over-minutes NÚMERO Muda os encontros" in told
    assert "[predefinição: 10; 0<=x<=10080]" in told


def test_the_list_of_commands_says_what_each_does_and_leaves_out_hidden_ones() -> None:
    told = helped(BLOCKROBOT_LANGUAGE="pt")
    assert "Comandos:\n  audit            Mostra tudo o que aconteceu às suas gravações, por ordem.\n" in told
    assert "probe" not in told
    assert all(len(line) <= 80 for line in told.splitlines())


@pytest.mark.parametrize(
    "arguments",
    [
        ("--language", "pt", "--help"),
        ("--help", "--language", "pt"),
        ("--help", "--language=pt"),
        ("--language", "pt", "records", "--help"),
        ("--language", "pt", "consent", "give", "--help"),
    ],
)
def test_the_language_that_is_named_is_that_of_the_help_on_whichever_side_it_stands(arguments: tuple[str, ...]) -> None:
    for environment, given in (("en", "pt"), ("pt", "en")):
        line = [word.replace("pt", given) if "language" in word or word == "pt" else word for word in arguments]
        told = CliRunner(env={"BLOCKROBOT_LANGUAGE": environment}).invoke(main, ["wallet", *line]).output
        assert told.startswith({"pt": "Utilização: ", "en": "Usage: "}[given])


def test_a_group_without_a_command_tells_its_help_in_portuguese() -> None:
    told = CliRunner(env={"BLOCKROBOT_LANGUAGE": "pt"}).invoke(main, ["wallet", "consent"])
    assert (told.exit_code, "Opções:" in told.output) == (2, True)


def test_an_unknown_language_is_wrong_usage_also_beside_help() -> None:
    told = CliRunner().invoke(main, ["wallet", "--language", "klingon", "--help"])
    assert (told.exit_code, "'klingon'" in told.output) == (2, True)


@pytest.mark.parametrize("arguments", [("officer", "--help"), ("--help",), ("robot", "--help")])
def test_the_help_of_others_than_patients_stays_english(arguments: tuple[str, ...]) -> None:
    assert CliRunner(env={"LANG": "pt_PT.UTF-8"}).invoke(main, arguments).output.startswith("Usage: ")


def completed(*arguments: str, incomplete: str = "") -> list[CompletionItem]:
    return ShellComplete(main, {}, "blockrobot", "_BLOCKROBOT_COMPLETE").get_completions(list(arguments), incomplete)


@pytest.mark.parametrize(
    ("arguments", "incomplete", "said"),
    [
        (("wallet",), "aud", {"audit": "Mostra tudo o que aconteceu às suas..."}),
        (
            ("wallet",),
            "--key",
            {
                "--keyring": section("help", "pt")[
                    "Take the passphrase from the system's keyring (see `wallet keyring store`)."
                ]
            },
        ),
        (("wallet", "consent"), "wi", {"withdraw": "Retira o consentimento que deu: todo, se..."}),
        (("wallet", "consent", "give"), "--js", {"--json": "Escreve um objeto JSON."}),
        (("wallet", "records"), "--he", {"--help": "Mostra esta mensagem e termina."}),
    ],
)
def test_a_shell_says_of_what_it_completes_in_portuguese_what_it_does(
    arguments: tuple[str, ...], incomplete: str, said: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BLOCKROBOT_LANGUAGE", "pt")
    assert {item.value: item.help for item in completed(*arguments, incomplete=incomplete)} == said
    monkeypatch.setenv("BLOCKROBOT_LANGUAGE", "en")
    (english,) = completed(*arguments, incomplete=incomplete)
    assert (english.value in said, english.help in said.values()) == (True, False)


def test_completing_in_portuguese_leaves_the_commands_as_they_were(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BLOCKROBOT_LANGUAGE", "pt")
    assert completed("wallet", "consent", "give", incomplete="--")
    assert all(english_of(EVERY[words]) == english_of(command) for words, command in commands())
    assert "Print one JSON object." in english_of(EVERY["wallet consent give"])


def test_a_patient_whose_system_speaks_portuguese_reads_the_help_so() -> None:
    system = {name: value for name, value in os.environ.items() if not name.startswith(("LC_", "BLOCKROBOT_LANGUAGE"))}
    done = subprocess.run(
        [BLOCKROBOT, "wallet", "erase", "--help"],
        env={**system, "LANG": "pt_PT.UTF-8", "COLUMNS": "80"},
        capture_output=True,
        check=True,
    )
    told = one_line(done.stdout.decode("utf-8"))
    assert told.startswith("Utilização: blockrobot wallet erase [OPÇÕES] [GRAVAÇÃO]... Apaga gravações")
    assert "--wait Espera até que todos os depositários tenham confirmado." in told
    assert done.stderr == b""


def test_the_reference_is_the_same_whatever_the_system_speaks() -> None:
    told = CliRunner(env={"LANG": "pt_PT.UTF-8", "BLOCKROBOT_LANGUAGE": "pt"}).invoke(main, ["reference", "--check"])
    assert told.exit_code == 0
    assert told.output == CliRunner(env={"LANG": "C.UTF-8"}).invoke(main, ["reference", "--check"]).output


def flat(forms: str | Sequence[str]) -> tuple[str, ...]:
    return (forms,) if isinstance(forms, str) else tuple(forms)


def test_clicks_catalogue_is_made_from_its_source_and_puts_in_nothing_that_the_english_does_not() -> None:
    folder = FOLDER / "pt" / "LC_MESSAGES"
    source = read_po(io.BytesIO((folder / "messages.po").read_bytes()), "pt", abort_invalid=True)
    made = read_mo(io.BytesIO((folder / "messages.mo").read_bytes()))
    said = {flat(one.id): flat(one.string) for one in source if one.id}
    assert {flat(one.id): flat(one.string) for one in made if one.id} == said, "`make docs` makes it"
    for english, told in said.items():
        for form, told_form in zip(english, told, strict=True):
            assert told_form
            assert set(re.findall(r"{.+?}", told_form)) <= set(re.findall(r"{.+?}", form)), form


def test_a_program_that_is_started_meanwhile_keeps_its_own_language(monkeypatch: pytest.MonkeyPatch) -> None:
    """A browser that a command opens would else speak the wallet's language from then on."""
    monkeypatch.setenv("LANGUAGE", "de")
    tell = "import os; print(os.environ['LANGUAGE'])"
    with click_speaks("pt"):
        assert gettext.gettext("Aborted!") == "Interrompido."
        assert subprocess.run([sys.executable, "-c", tell], capture_output=True, check=True).stdout == b"de\n"
    assert gettext.gettext("Aborted!") == "Aborted!"

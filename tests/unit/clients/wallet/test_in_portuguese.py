"""Commands in Portuguese, as a patient sees them; a program is told the same in every language."""

from __future__ import annotations

import ast
import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import click
import pytest
from click.testing import CliRunner, Result

from clients.wallet.cli import main as cli
from clients.wallet.cli.wallet_context import print_linked_moves, print_linking_notice
from clients.wallet.commands import consent_commands, serve_commands
from clients.wallet.commands.account import rotate_commands
from clients.wallet.consent.notice_reading import NoticeView
from clients.wallet.consent.receipt_fetching import Receipts
from clients.wallet.ledger.visit_status import BreachEnd, OfficersErasure, VisitRights
from clients.wallet.presentation.audit_story import describe_event
from clients.wallet.presentation.consent_text import notice_answer, notice_text
from clients.wallet.presentation.former_text import words_lines
from clients.wallet.presentation.translations import code_text, section
from clients.wallet.presentation.visit_status_text import rights_lines
from clients.wallet.text_catalogue import DEFAULT_LANGUAGE, load
from consensus.errors import BlockRobotError
from consensus.rights import right_codes as codes
from consensus.rights.notices import NOTICE_LINES, NoticeVersion, PublishedNotice, notice_lines
from consensus.rights.purposes import PURPOSES
from consensus.rights.right_codes import LOST_KEY_REASONS
from consensus.state.rights import RestrictionRow
from network.cli.main import main
from network.notices.notice_publishing import demo_notice
from tests.world.commands import open_for_commands
from tests.world.dicts import NOW_MS, World
from tests.world.stolen import WalletHarness

BREACH = b"\xb1" * 32


@pytest.fixture
def run(world: World, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Run `wallet ...` in Portuguese, on this wallet and network."""
    open_for_commands(monkeypatch, lambda: world.wallet)

    def call(*arguments: str, language: str = "pt") -> Result:
        return CliRunner().invoke(cli.wallet, ["--language", language, *arguments])

    return call


RIGHTS = VisitRights(
    RestrictionRow("accuracy", False, 0, NOW_MS, [b"1", b"2"], NOW_MS),
    ("research",),
    2,
    BREACH,
    BreachEnd(BREACH, "erased", "matched-wrongly", NOW_MS),
    (OfficersErasure(BREACH, "key-lost", 1, NOW_MS),),
)


def test_what_stands_of_a_visit_is_said_in_the_language_that_is_asked_for() -> None:
    end, officers, restricted, objected, corrected = rights_lines(RIGHTS, "pt")
    assert end.endswith(
        "um encarregado mandou apagá-lo, e o que resta fica fechado a todos (o robô confundiu duas pessoas)."
    )
    assert officers.startswith("Dois encarregados em conjunto mandaram apagar 1 gravação deste encontro em ")
    assert "chave perdida. A pessoa perdeu a sua chave para sempre" in officers
    assert restricted.startswith("O uso de 2 gravações deste encontro está limitado (não está certo): só você as vê, e")
    assert (objected, corrected) == (
        "Opôs-se a que seja entregue para: investigação (research).",
        "Tem 2 correções suas.",
    )
    assert rights_lines(RIGHTS, "en")[3:] == [
        "You objected to its release for: research.",
        "It has 2 corrections of yours.",
    ]


@pytest.mark.parametrize(
    ("kind", "data", "said"),
    [
        (
            "granted",
            {"grant_id": BREACH, "records": 2, "purpose": "care"},
            "2 gravações para cuidados (care), partilha b1b1b1b1b1b1",
        ),
        ("grant_revoked", {"grant_id": BREACH}, "partilha b1b1b1b1b1b1"),
        (
            "grant_noticed",
            {"grant_id": BREACH, "records": [b"1"]},
            "as cópias de 1 gravação foram eliminadas, diz quem",
        ),
        ("access_requested", {"grant": BREACH, "records": 1}, "por quem recebeu a partilha b1b1b1b1b1b1"),
        ("access_requested", {"records": 1}, ""),
        ("breach_notified", {"recipient": "authority", "late": True}, "informado: a autoridade, tarde"),
        ("corrected", {"number": 0, "kind": "attribution"}, "número 1, quem se vê"),
        ("erased_by_officers", {"records": 1, "reason": "owner-died"}, "1 gravação, por dois encarregados em conjunto"),
    ],
)
def test_what_an_entry_says_beyond_its_kind_is_in_portuguese(kind: str, data: dict[str, Any], said: str) -> None:
    assert describe_event(kind, data, "pt").startswith(said)
    assert bool(said) == bool(describe_event(kind, data, "pt"))


@pytest.mark.parametrize(
    ("table", "known"),
    [
        ("purpose", PURPOSES),
        ("ground", codes.GROUNDS),
        ("correction", codes.CORRECTIONS),
        ("risk", codes.RISKS),
        ("recipient", codes.RECIPIENTS),
        ("outcome", codes.OUTCOMES),
        ("reason", codes.REASONS | LOST_KEY_REASONS),
    ],
)
def test_every_code_has_words_in_portuguese_and_stays_as_it_is_in_english(table: str, known: dict[str, str]) -> None:
    assert section(f"code.{table}", DEFAULT_LANGUAGE) == {code: code for code in known}
    for code in known:
        assert code_text(table, code, language="pt") != code


def test_a_code_that_nobody_knows_is_shown_as_it_is() -> None:
    assert code_text("ground", "whim", language="pt") == "whim"


def test_every_kind_of_entry_has_a_name_and_a_sentence_on_the_page() -> None:
    kinds = section("code.kind", DEFAULT_LANGUAGE)
    assert kinds == {kind: kind for kind in kinds}
    told = {key.removeprefix("page.story.") for key in load("pt") if key.startswith("page.story.")}
    assert {kind for kind in kinds if kind not in told} == {"verdict"}


def test_the_reasons_for_which_officers_erase_are_those_that_are_published() -> None:
    assert section("lost_key_reason", DEFAULT_LANGUAGE) == LOST_KEY_REASONS


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> WalletHarness:
    monkeypatch.setenv("BLOCKROBOT_LANGUAGE", "pt")
    return WalletHarness(tmp_path, monkeypatch)


def test_new_words_are_asked_back_in_portuguese(
    desk: WalletHarness, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    assert desk.folder
    asked: list[str] = []
    words = ["um", "dois", "três"]

    def prompt(question: str, **_: Any) -> str:
        asked.append(question)
        if len(asked) == 2:
            return "zero"
        return words[int(question.rsplit(maxsplit=1)[-1]) - 1] if question.startswith("Palavra") else ""

    monkeypatch.setattr(click, "prompt", prompt)
    rotate_commands._hand_over(" ".join(words), None)
    assert (asked[0], asked[1]) == ("Quando estiver tudo escrito, prima Enter", asked[2])
    said = capsys.readouterr().out
    assert "As suas 24 palavras novas." in said
    assert "Para ver se ficaram bem escritas, uma delas" in said
    assert "Essa não é a palavra" in said


def test_former_words_are_spoken_of_in_the_language_that_the_page_asks_for(desk: WalletHarness) -> None:
    desk.run("records")
    content = desk.story.open().store.content
    visit = content.visits[0]
    visit.stuck = True
    (stuck,) = words_lines(content, "pt")
    assert stuck.startswith("1 encontro ainda obedece às suas palavras anteriores, e já não pode receber outra chave")
    visit.taken = True
    (taken,) = words_lines(content, "pt")
    assert taken.startswith("1 encontro recebeu uma chave que não vem das suas palavras")
    assert words_lines(content, "en")[0].startswith("1 visit was given a key that is not of your words")


def test_what_acting_on_several_visits_tells_is_said_in_portuguese(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("BLOCKROBOT_LANGUAGE", "pt")
    print_linking_notice(3)
    print_linked_moves(2, with_member=True)
    acting, moving = capsys.readouterr().err.splitlines()
    assert acting.startswith("Isto fala por 3 dos seus encontros")
    assert moving.startswith(
        "2 dos seus encontros recebem já uma nova chave: quem lê o registo pode ver, para sempre, de"
    )


def test_receipts_of_consent_are_told_in_portuguese(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    statement = SimpleNamespace(
        time_ms=NOW_MS, status="given", purposes=["care"], sensors=[], height=7, txid=bytes(32), index=0
    )
    receipt = SimpleNamespace(statement=statement, node="node-1", organisation="hospital", published=None)
    entry = SimpleNamespace(document="{}")
    missing = ((b"\xab" * 32, BlockRobotError("NODE_UNREACHABLE")),)
    found = Receipts((receipt,), (entry,), missing)  # type: ignore[arg-type]
    monkeypatch.setattr(consent_commands, "run_with_wallet", lambda *_: (found, b"{}"))
    out = tmp_path / "recibos.json"
    words = ["--language", "pt", "consent", "receipts"]
    told = " ".join(CliRunner().invoke(cli.wallet, [*words, "--out", str(out)]).output.split())
    assert (
        "dado: cuidados (care) por todos os sensores (bloco 7, assinado por node-1 de hospital e por si, sem aviso)"
        in told
    )
    assert "Falta, da transação abababababab: Nenhum nó da rede respondeu." in told
    assert f"Estão em {out}." in told
    monkeypatch.setattr(consent_commands, "run_with_wallet", lambda *_: (Receipts((), (), ()), b""))
    assert "Não há nenhum recibo nesta carteira" in CliRunner().invoke(cli.wallet, words).output


def steps_in_the_code() -> set[str]:
    """Every step that a job of the page, or an export, tells in the wallet's code."""
    found = set()
    for path in Path(cli.__file__).parents[1].rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute | ast.Name) and node.args:
                name = node.func.attr if isinstance(node.func, ast.Attribute) else node.func.id
                first = node.args[0]
                if name in {"tell", "_heard", "heard"} and isinstance(first, ast.Constant):
                    found.add(str(first.value))
    return found


def test_every_step_of_a_job_has_words_on_the_page() -> None:
    steps = steps_in_the_code()
    assert {"writing it into the ledger", "proofs of visits"} <= steps
    assert steps | {"checking the file", "checking records"} <= {
        key.replace("_", " ") for key in section("page.step", "pt")
    }
    for key, said in section("page.step", "pt").items():
        assert said != load("en")[f"page.step.{key}"]


def test_wrong_usage_is_told_in_portuguese_and_to_a_program_in_english(run: Any, world: World) -> None:
    world.record(world.open_visit())
    for arguments, said in (
        (("records", "--day", "amanhã"), "'amanhã' não é um dia: escreva today, yesterday, 2027-01-31"),
        (("erase",), "Indique as gravações a apagar, ou --visit, ou diga --all."),
        (("restrict", "--ground", "legal-claim"), "Indique gravações, ou um encontro inteiro com --visit."),
        (("--profile", "a b", "records"), "O nome de um perfil só tem letras, algarismos, - e _."),
    ):
        spoken = run(*arguments)
        assert (spoken.exit_code, said in spoken.output) == (2, True), spoken.output
    program = CliRunner().invoke(main, ["wallet", "--language", "pt", "records", "--day", "amanhã", "--json"])
    assert program.exit_code == 2
    assert json.loads(program.stdout)["error"]["detail"].startswith("'amanhã' is no day: write today")


def test_a_name_that_fits_nothing_is_refused_in_portuguese(run: Any, world: World) -> None:
    world.record(world.open_visit())
    refused = run("erase", "0" * 12, "--yes")
    assert f"Não tem nenhuma gravação cujo nome comece por {'0' * 12}." in refused.output
    assert "(" not in refused.output.splitlines()[0], "no English in brackets"


def test_who_tells_nothing_is_named_in_portuguese(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BLOCKROBOT_LANGUAGE", "pt")
    (told,) = notice_text(NoticeView("hospital", None, 7))
    assert told.startswith("hospital não publicou nenhum aviso de privacidade: pergunte no balcão")


def test_a_notice_has_portuguese_headings_and_the_words_that_were_published(monkeypatch: pytest.MonkeyPatch) -> None:
    notice = demo_notice()
    row = NoticeVersion("hospital", 1, b"\x01" * 32, 1, NOW_MS)
    told = NoticeView("hospital", PublishedNotice(row, notice), 7)
    assert section("notice.line", "en") == NOTICE_LINES
    english = [line.strip() for line in notice_text(told)[1:-1]]
    assert english == notice_lines(notice) == notice_answer(told).lines
    monkeypatch.setenv("BLOCKROBOT_LANGUAGE", "pt")
    head, *lines, last = notice_text(told)
    assert head.startswith("O que a organização hospital lhe comunica")
    assert (len(lines), lines[0].startswith("  Responsável: ")) == (len(english), True)
    assert all(right.words in "".join(lines) for right in notice.rights)
    for line, before in zip(lines, english, strict=True):
        assert line.strip().partition(":")[0] != before.partition(":")[0]
    assert "  O seu direito (art. 17): " in "\n".join(lines)
    assert last == "  Atrás de cada título estão as palavras de hospital, tal como as publicou: não se traduzem."
    assert notice_answer(told).lines == english, "programs are told the same in every language"


def test_where_the_page_is_stands_in_portuguese(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    monkeypatch.setenv("BLOCKROBOT_LANGUAGE", "pt")
    serve_commands._tell("http://127.0.0.1:1", tmp_path / "abrir.html", no_browser=True, as_json=False)
    first, second, third = capsys.readouterr().out.splitlines()
    assert first == "Abra este ficheiro no seu navegador; funciona uma só vez, durante dois minutos:"
    assert second.strip() == str(tmp_path / "abrir.html")
    assert third.startswith("Deixe esta janela aberta.")

"""Commands in Portuguese, as a patient sees them; a program is told the same in every language."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from clients.wallet import cli, records_command, rights_commands
from clients.wallet.language import DEFAULT_LANGUAGE, code_text, load, section
from clients.wallet.rights import describe_event
from clients.wallet.standing import BreachEnd, OfficersErasure, VisitRights
from clients.wallet.standing_words import standing_lines
from consensus.records import rights as codes
from consensus.records.lost_keys import LOST_KEY_REASONS
from tests.unit.clients.wallet.conftest import NOW_MS, World
from tests.unit.clients.wallet.test_rights import Saying

BREACH = b"\xb1" * 32


@pytest.fixture
def saying(world: World, monkeypatch: pytest.MonkeyPatch) -> Saying:
    told = {"height": 8, "until_ms": NOW_MS, "number": 0, "breach_id": BREACH, "due_ms": NOW_MS, "org": "hospital"}
    saying = Saying(told)
    monkeypatch.setattr(world.network, "call", saying)
    return saying


@pytest.fixture
def run(world: World, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Run `wallet ...` in Portuguese, on this wallet and network."""
    for module in (cli, records_command, rights_commands):
        monkeypatch.setattr(module, "run_opened", lambda _, action: asyncio.run(action(world.wallet)))

    def call(*arguments: str, language: str = "pt") -> Result:
        return CliRunner().invoke(cli.wallet, ["--language", language, *arguments])

    return call


def test_rights_are_used_in_portuguese(world: World, saying: Saying, run: Any, tmp_path: Path) -> None:
    assert saying
    visit = world.open_visit()
    record_id = world.record(visit).upload.record_id.hex()
    (tmp_path / "certo.txt").write_text("É a minha irmã.\n", encoding="utf-8")
    name, right = visit.owner.hex()[:12], str(tmp_path / "certo.txt")
    for arguments, said in (
        (("restrict", "--visit", name, "--ground", "legal-claim"), f"Uso limitado: todo o encontro {name}."),
        (("lift", record_id), f"Limitação levantada: 1 gravação do encontro {name}."),
        (("object", "--purpose", "demo", "--now"), "1 encontro deixa de ser entregue para isso."),
        (("correct", "--visit", name, "--text-file", right), f"A correção 1 sobre todo o encontro {name} está"),
        (("wrong-person", name, "--yes"), "É o caso b1b1b1b1b1b1."),
    ):
        spoken = run(*arguments)
        assert (spoken.exit_code, said in spoken.output) == (0, True), spoken.output
        assert set(json.loads(run(*arguments, "--json").stdout)) == set(
            json.loads(run(*arguments, "--json", language="en").stdout)
        )


STANDING = VisitRights(
    {"ground": "accuracy", "whole": False, "until_ms": NOW_MS, "records": [b"1", b"2"]},
    ("research",),
    2,
    BREACH,
    BreachEnd(BREACH, "erased", "matched-wrongly", NOW_MS),
    (OfficersErasure(BREACH, "key-lost", 1, NOW_MS),),
)


def test_what_stands_of_a_visit_is_said_in_the_language_that_is_asked_for() -> None:
    end, officers, restricted, objected, corrected = standing_lines(STANDING, "pt")
    assert end.endswith(
        "um encarregado mandou apagá-lo, e o que resta fica fechado a todos (o robô confundiu duas pessoas)."
    )
    assert officers.startswith("Dois encarregados em conjunto mandaram apagar 1 gravação deste encontro em ")
    assert "chave perdida. A pessoa perdeu a sua chave para sempre" in officers
    assert restricted.startswith("O uso de 2 gravações deste encontro está limitado (não está certo): só você as vê, e")
    assert (objected, corrected) == ("Opôs-se a que seja entregue para: research.", "Correções suas sobre ele: 2.")
    assert standing_lines(STANDING, "en")[3:] == [
        "You objected to its release for: research.",
        "It has 2 corrections of yours.",
    ]


def test_the_audit_names_what_happened_in_portuguese_and_tells_a_program_the_codes(world: World, run: Any) -> None:
    visit = world.open_visit()
    world.append_audit(visit.owner, "restricted")
    world.network.trails[visit.owner][-1]["data"] = {"ground": "legal-claim", "until_ms": 5}
    told = run("audit").output
    assert "uso limitado" in told
    assert "motivo: direito a defender, guardado para além do prazo" in told
    (entry,) = json.loads(run("audit", "--json").stdout)["entries"]
    assert (entry["kind"], entry["detail"]) == ("restricted", "ground: legal-claim, kept beyond its time")


@pytest.mark.parametrize(
    ("kind", "data", "said"),
    [
        (
            "granted",
            {"grant_id": BREACH, "records": 2, "purpose": "care"},
            "2 gravações para care, partilha b1b1b1b1b1b1",
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

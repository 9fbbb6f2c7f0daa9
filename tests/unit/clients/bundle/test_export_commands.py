"""The command: it warns and asks before anything is asked for or written, and says what is missing."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from clients.wallet.commands import export_commands
from clients.wallet.commands.export_commands import export
from clients.wallet.presentation.translations import LANGUAGE_VARIABLE, section
from tests.world.commands import open_for_commands
from tests.world.ward import Ward

DAY_MS = 24 * 3_600_000
NOW_MS = 1_900_000_000_000


@pytest.fixture
def ward(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Ward:
    ward = Ward(tmp_path)
    open_for_commands(monkeypatch, lambda: ward.wallet)
    return ward


def run(*arguments: object, answer: str | None = None) -> Result:
    result = CliRunner().invoke(export, [str(each) for each in arguments], input=answer)
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result


def test_it_says_first_what_a_bundle_gives_away(ward: Ward, tmp_path: Path) -> None:
    for _ in range(2):
        ward.record(ward.open_visit())
    result = run(tmp_path / "mine.zip", "--yes", "--now")
    assert result.exit_code == 0
    for part in ("2 visits with 2 records", "of one person", "which member", "It is not encrypted", "--now", "offline"):
        assert part in result.output
    assert result.output.index("of one person") < result.output.index("4 pictures")
    quiet = run(tmp_path / "less.zip", "--yes", "--no-identity", "--no-pictures").output
    assert "which member" not in quiet
    assert "what the pictures show" not in quiet


def test_a_ctrl_c_says_that_nothing_was_written(ward: Ward, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    ward.record(ward.open_visit())
    monkeypatch.setattr(export_commands, "write_bundle", stop)
    out = tmp_path / "mine.zip"
    stopped = run(out, "--yes", "--now")
    assert (stopped.exit_code, "Aborted" in stopped.output, out.exists()) == (1, False, False)
    assert f"Stopped. {out} was not written." in stopped.output


def test_without_a_terminal_it_asks_for_yes_and_does_nothing(ward: Ward, tmp_path: Path) -> None:
    ward.record(ward.open_visit())
    height = ward.chain.height
    result = run(tmp_path / "mine.zip")
    assert (result.exit_code, "--yes" in result.output) == (2, True)
    assert not (tmp_path / "mine.zip").exists()
    assert ward.chain.height == height


def test_as_json_it_tells_what_is_there_and_what_is_missing(ward: Ward, tmp_path: Path) -> None:
    visit = ward.open_visit()
    away = ward.record(visit)
    ward.record(visit)
    ward.network.custody.refusals[away] = "NODE_UNREACHABLE"
    result = run(tmp_path / "mine.zip", "--yes", "--json")
    told = json.loads(result.stdout)
    assert (result.exit_code, told["ok"], told["is_complete"]) == (0, True, False)
    assert [(row["record_id"], row["code"]) for row in told["problems"]] == [(away.hex(), "NODE_UNREACHABLE")]
    assert (told["visits"], told["records"], told["pictures"]) == (1, 2, 2)
    assert told["bytes"] == (tmp_path / "mine.zip").stat().st_size
    assert "missing" in run(tmp_path / "again.zip", "--yes").output


def test_a_file_that_is_there_is_seen_before_anything_is_asked_for(ward: Ward, tmp_path: Path) -> None:
    ward.record(ward.open_visit())
    height = ward.chain.height
    (tmp_path / "mine.zip").write_text("mine")
    result = run(tmp_path / "mine.zip", "--yes", "--json")
    assert (result.exit_code, json.loads(result.stdout)["error"]["code"]) == (1, "FILE_EXISTS")
    assert ward.chain.height == height
    assert run(tmp_path / "mine.zip", "--yes", "--force").exit_code == 0


def test_a_visit_that_she_denied_is_named_and_shows_nothing(ward: Ward, tmp_path: Path) -> None:
    visit = ward.open_visit()
    record_id = ward.record(visit)
    key = asyncio.run(ward.owner_key(visit.owner))
    ward.chain.must(key, "rights", "wrong_person")
    told = json.loads(run(tmp_path / "mine.zip", "--yes", "--json").stdout)
    assert {row["record_id"] for row in told["problems"]} == {record_id.hex()}
    assert (told["records"], told["pictures"]) == (1, 0)


def test_it_counts_an_erased_record_before_and_after(ward: Ward, tmp_path: Path) -> None:
    visit = ward.open_visit()
    erased, _ = ward.record(visit), ward.record(visit)
    asyncio.run(ward.erase(visit, [erased]))
    said = run(tmp_path / "mine.zip", "--yes", "--now").output
    assert said.count("2 records") == 2, said


@pytest.mark.parametrize(
    "arguments",
    [
        ("--records", "zz"),
        ("--records", "00"),
        ("--from", "yesterday"),
        ("--until", "2026-13-01"),
        ("--from", "2026-02-01", "--until", "2026-01-01"),
        ("--from", "-99999999d"),
    ],
)
def test_wrong_use_is_told_with_an_example_of_the_right_one(
    ward: Ward, tmp_path: Path, arguments: tuple[str, ...]
) -> None:
    assert run(tmp_path / "mine.zip", "--yes", *arguments).exit_code == 2
    assert not (tmp_path / "mine.zip").exists()


def test_a_purpose_that_is_not_published_and_a_strangers_record_are_refused(ward: Ward, tmp_path: Path) -> None:
    ward.record(ward.open_visit())
    assert run(tmp_path / "mine.zip", "--yes", "--purpose", "curiosity").exit_code == 2
    assert run(tmp_path / "mine.zip", "--yes", "--records", "00" * 16).exit_code == 3


def test_several_records_may_be_named_at_once(ward: Ward, tmp_path: Path) -> None:
    visit = ward.open_visit()
    ids = [ward.record(visit).hex() for _ in range(3)]
    result = run(tmp_path / "mine.zip", "--yes", "--json", "--records", f"{ids[0]}, {ids[2]}", "--records", ids[0])
    assert json.loads(result.stdout)["records"] == 2


def test_in_portuguese_it_warns_asks_and_says_what_is_missing_and_json_stays_as_it_is(
    ward: Ward, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    away = ward.record(ward.open_visit())
    ward.record(ward.open_visit())
    ward.network.custody.refusals[away] = "NODE_UNREACHABLE"
    monkeypatch.setenv(LANGUAGE_VARIABLE, "pt")
    said = run(tmp_path / "mine.zip", "--yes", "--now").output
    for part in ("2 encontros com 2 gravações.", "de uma só pessoa", "Não está cifrado", "de uma só vez (--now)"):
        assert part in said
    assert f"falta (gravação {away.hex()}): Nenhum nó da rede respondeu. (" in said
    assert "provado até ao bloco" in said
    assert "Qualquer pessoa o pode verificar, sem rede:" in said
    (problem,) = json.loads(run(tmp_path / "told.zip", "--yes", "--json", "--now").stdout)["problems"]
    assert problem["sentence"].startswith("No custodian gave it: ")


def test_each_step_of_an_export_is_said_in_portuguese(
    ward: Ward, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ward.record(ward.open_visit())
    heard: list[str] = []
    monkeypatch.setattr(export_commands, "show_progress", lambda **_: lambda what, _done, _of: heard.append(what))
    run(tmp_path / "mine.zip", "--yes")
    english = set(heard)
    assert english <= set(map(str, section("export.step", "en").values()))
    heard.clear()
    monkeypatch.setenv(LANGUAGE_VARIABLE, "pt")
    run(tmp_path / "meu.zip", "--yes")
    assert {"provas dos encontros", "gravações obtidas"} <= set(heard)
    assert not english & set(heard)

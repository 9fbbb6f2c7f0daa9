"""The commands of sharing: everything is said before it is asked for, and nothing is confirmed that is not so."""

from __future__ import annotations

import asyncio
import datetime
import json
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner, Result

from clients.wallet.cli import main
from clients.wallet.commands import erase_command, inbox_commands, share_commands
from clients.wallet.commands.share_commands import read_end, say_step
from clients.wallet.consent.rights_requests import RecordChoice, Rights
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.present.translations import LANGUAGE_VARIABLE, LANGUAGES, section
from clients.wallet.sharing import outgoing_shares
from clients.wallet.sharing.incoming_shares import KIND_CORRECTED, KIND_RESTRICTED, TO_DELETE
from clients.wallet.sharing.outgoing_shares import STEP_KEYS, STEP_PARTS, STEP_SIGNING
from consensus.errors import BlockRobotError
from consensus.records.sharing import GRANT_STEP_MS
from tests.unit.clients.wallet.shared_ward import WEEK_MS, SharedWard

NAMES = {command.name: command for command in (*share_commands.COMMANDS, *inbox_commands.COMMANDS, erase_command.erase)}


class People:
    """A ward, a doctor, and their command lines."""

    def __init__(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        self.ward = SharedWard(folder)
        self.doctor = self.ward.come_in("doctor", "staff")
        self.opened = self.ward.wallet
        for module in (share_commands, inbox_commands, erase_command):
            monkeypatch.setattr(module, "run_with_wallet", self._run_opened)
        monkeypatch.setattr(share_commands.time, "time_ns", lambda: self.ward.chain.time_ms * 1_000_000)

    def _run_opened(self, _: click.Context, action: Callable[[Wallet], Awaitable[Any]]) -> Any:
        return asyncio.run(action(self.opened))  # type: ignore[arg-type]

    def run(self, wallet: Wallet, name: str, *arguments: object) -> Result:
        self.opened = wallet
        result = CliRunner().invoke(NAMES[name], [str(each) for each in arguments])
        assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
        return result

    def told(self, wallet: Wallet, name: str, *arguments: object) -> Any:
        result = self.run(wallet, name, *arguments, "--json")
        assert result.exit_code == 0, result.output
        return json.loads(result.stdout)

    def share(self, record_id: bytes, *more: object) -> Result:
        handle = self.doctor.store.content.handle.hex()
        arguments = [record_id.hex(), "--with", handle, "--as", "Dr Weber", "--purpose", "care", "--for", "7d", *more]
        return self.run(self.ward.wallet, "share", *arguments)


@pytest.fixture
def people(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> People:
    return People(tmp_path, monkeypatch)


def test_without_a_terminal_nothing_is_shared_unless_yes_is_said(people: People) -> None:
    _, (record_id,) = people.ward.record_visit(1)
    height = people.ward.chain.height
    refused = people.share(record_id)
    assert (refused.exit_code, "--yes" in refused.output) == (2, True)
    assert people.ward.chain.height == height


def test_before_it_is_asked_it_says_what_is_seen_how_long_and_what_cannot_be_undone(
    people: People, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, (record_id,) = people.ward.record_visit(1)
    asked: list[str] = []
    monkeypatch.setattr(share_commands, "ask_or_say", lambda question, *, yes, told: asked.append(f"{told} {question}"))
    done = people.share(record_id)
    (text,) = asked
    for part in ("2 pictures", "Dr Weber, staff of ward", "care: Care and treatment", "until", "end it at any time"):
        assert part in text
    for part in ("What the other sees", "cannot be undone", "kept a copy", "not with whom", "Share that?"):
        assert part in text
    assert done.exit_code == 0
    assert "Shared with Dr Weber" in done.output


def test_the_whole_story_on_two_command_lines(people: People, tmp_path: Path) -> None:
    ward, ann, doctor = people.ward, people.ward.wallet, people.doctor
    visit, (record_id,) = ward.record_visit(1)
    assert people.told(doctor, "handle")["handle"] == doctor.store.content.handle.hex()
    people.share(record_id, "--yes")
    (row,) = people.told(ann, "shares")["shares"]
    assert (row["name"], row["status"], row["looks"], row["until_ms"] % GRANT_STEP_MS) == ("Dr Weber", "open", [], 0)
    name = row["grant_id"][:12]
    assert f"wallet look {name}" in people.run(doctor, "inbox").output
    out = tmp_path / "shared"
    looked = people.run(doctor, "look", name, "--out", out)
    assert "2 of 2 pictures are as the robot took them" in looked.output
    assert len(list((out / record_id.hex()).glob("*.depth.png"))) == 2
    assert len(people.told(ann, "shares")["shares"][0]["looks"]) == 1
    lines = people.run(ann, "shares").output
    assert "handed out" not in lines, "a custodian says that it is ready, and asks only then who fetches"

    asyncio.run(ward.erase(visit, [record_id]))
    said = people.run(doctor, "inbox").output
    for part in ("was erased", "delete every copy", str(out), f"confirm-deleted {name}"):
        assert part in said
    held = people.run(doctor, "confirm-deleted", name, "--yes")
    assert (held.exit_code, "COPIES_REMAIN" in held.output) == (1, True)
    assert people.told(doctor, "confirm-deleted", name, "--yes", "--delete")["records"] == [record_id.hex()]
    assert not (out / record_id.hex()).exists()
    assert people.told(ann, "shares")["shares"][0]["confirmed_deleted"] == [record_id.hex()]
    assert "copies of 1 record are deleted" in people.run(ann, "shares").output
    again = people.run(doctor, "confirm-deleted", name, "--yes")
    assert (again.exit_code, "NOTHING_TO_CONFIRM" in again.output) == (3, True)


def test_only_what_look_wrote_is_deleted_and_a_folder_with_other_files_stays_and_is_named(
    people: People, tmp_path: Path
) -> None:
    ward, doctor = people.ward, people.doctor
    visit, (first, second) = ward.record_visit()
    asyncio.run(ward.share(doctor))
    name = people.told(ward.wallet, "shares")["shares"][0]["grant_id"][:12]
    out = tmp_path / "shared"
    people.run(doctor, "look", name, "--out", out)
    note = out / first.hex() / "mynote.txt"
    note.write_text("mine")
    asyncio.run(ward.erase(visit, [first, second]))
    done = people.run(doctor, "confirm-deleted", name, "--delete", "--yes")
    assert done.exit_code == 0, done.output
    assert [path.name for path in note.parent.iterdir()] == ["mynote.txt"]
    assert not (out / second.hex()).exists()
    assert f"{note.parent} stays" in done.output.replace("\n", "")
    assert "mynote.txt" in done.output


def test_an_erasure_that_is_late_names_who_had_received_it_all_the_same(
    people: People, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No custodian confirms in time: she hears that, and with whom she had shared it."""
    monkeypatch.setattr(erase_command, "ERASE_WAIT_S", -1.0)
    _, (first,) = people.ward.record_visit(1)
    people.share(first, "--yes")
    late = people.run(people.ward.wallet, "erase", first.hex(), "--wait", "--yes")
    assert "were shared with Dr Weber" in late.stdout
    assert "confirmed by 0 of 2 custodians" in late.stdout
    assert "ERASURE_NOT_CONFIRMED" in late.stderr
    _, (second,) = people.ward.record_visit(1)
    people.share(second, "--yes")
    told = people.run(people.ward.wallet, "erase", second.hex(), "--wait", "--yes", "--json")
    answer = json.loads(told.stdout)
    assert (answer["ok"], answer["error"]["code"]) == (False, "ERASURE_NOT_CONFIRMED")
    assert (answer["recipients"][0]["name"], len(answer["erasures"])) == ("Dr Weber", 1)
    assert told.exit_code == late.exit_code != 0


def test_the_command_that_an_inbox_names_can_be_typed_as_it_stands(people: People) -> None:
    people.ward.record_visit()
    asyncio.run(people.ward.share(people.doctor))
    people.opened = people.doctor

    @click.group()
    @click.option("--profile", default="default")
    def wallet(profile: str) -> None:
        """A wallet's commands."""

    wallet.add_command(inbox_commands.inbox)
    for arguments, said in (([], ""), (["--profile", "doctor"], " --profile doctor")):
        result = CliRunner().invoke(wallet, [*arguments, "inbox"])
        assert f"blockrobot wallet{said} look " in result.output.replace("\n", " "), result.output


def test_the_command_that_ends_a_share_is_that_of_the_wallet_that_made_it(people: People) -> None:
    _, (record_id,) = people.ward.record_visit(1)
    handle = people.doctor.store.content.handle.hex()
    arguments = ["share", record_id.hex(), "--with", handle, "--purpose", "care", "--for", "7d", "--yes"]
    done = CliRunner().invoke(main.wallet, ["--profile", "anna", *arguments])
    (row,) = people.told(people.ward.wallet, "shares")["shares"]
    assert f"To end it: blockrobot wallet --profile anna revoke {row['grant_id'][:12]}" in done.output


def test_who_never_looked_is_told_and_has_nothing_to_delete(people: People) -> None:
    ward, doctor = people.ward, people.doctor
    visit, records = ward.record_visit()
    asyncio.run(ward.share(doctor))
    assert "To look: " in people.run(doctor, "inbox").output
    asyncio.run(ward.erase(visit, records))
    said = people.run(doctor, "inbox").output
    assert "2 of 2 records: were erased, or are over their time" in said
    assert "You never looked at it: there is nothing to delete" in said
    for part in ("delete every copy", "confirm-deleted", "To look: "):
        assert part not in said
    (row,) = people.told(doctor, "inbox")["received"]
    assert (row["open"], row["looked"], row["to_look"]) == (True, False, [])
    refused = people.run(doctor, "confirm-deleted", row["grant_id"][:12], "--yes")
    assert (refused.exit_code, "You never looked at it" in refused.output) == (3, True)


def test_what_was_ended_is_told_on_both_sides(people: People, tmp_path: Path) -> None:
    _, (record_id,) = people.ward.record_visit(1)
    people.share(record_id, "--yes")
    (row,) = people.told(people.ward.wallet, "shares")["shares"]
    assert "Ended: 1 record shared" in people.run(people.ward.wallet, "revoke", row["grant_id"][:8]).output
    again = people.run(people.ward.wallet, "revoke", row["grant_id"][:8])
    assert (again.exit_code, "You had ended that already" in again.output) == (0, True)
    told = json.loads(people.run(people.ward.wallet, "revoke", row["grant_id"][:8], "--json").output)
    assert (told["already_ended"], told["txid"]) == (True, None)
    assert "you ended it" in people.run(people.ward.wallet, "shares").output
    refused = people.run(people.doctor, "look", row["grant_id"][:8], "--out", tmp_path / "shared")
    assert "GRANT_ENDED" in refused.output
    assert not (tmp_path / "shared").exists()
    assert "its owner ended it" in people.run(people.doctor, "inbox").output


def test_a_non_member_is_refused_with_a_next_step(people: People) -> None:
    _, (record_id,) = people.ward.record_visit(1)
    visitor = people.ward.come_in("visitor", "subject")
    handle = visitor.store.content.handle.hex()
    arguments = [record_id.hex(), "--with", handle, "--purpose", "care", "--for", "7d", "--yes"]
    refused = people.run(people.ward.wallet, "share", *arguments)
    assert (refused.exit_code, "SHARE_WITH_NON_MEMBER" in refused.output) == (4, True)
    assert "This member's role is subject." in refused.output
    assert "Next step: Name a member of the staff or an officer." in " ".join(refused.output.split())
    assert "only staff and officers" in people.run(visitor, "handle").output


def test_the_inbox_tells_what_is_missing_of_ones_own_visits(people: People) -> None:
    ward = people.ward
    visit = ward.open_visit()
    ward.record(visit)
    ward.chain.must(ward.chain.robot.identity, "records", "close_visit", visit.owner, 3)
    assert "2 records are missing" in people.run(ward.wallet, "inbox").output
    (alarm,) = people.told(ward.wallet, "inbox")["alarms"]
    assert (alarm["visit"], alarm["missing_records"]) == (visit.owner.hex(), 2)
    assert "Nothing was shared with you" in people.run(people.doctor, "inbox").output


def test_a_share_that_cannot_be_read_is_named_with_why_beside_those_that_can(
    people: People, monkeypatch: pytest.MonkeyPatch
) -> None:
    ward, doctor = people.ward, people.doctor
    _, ids = ward.record_visit(2)
    for record_id in ids:
        people.share(record_id, "--yes")
    bad, good = people.told(doctor, "inbox")["received"]
    honest = doctor.values

    async def refuse_bad(keys: Any, session: Any) -> dict[bytes, Any]:
        if getattr(session, "grant_id", b"").hex() == bad["grant_id"]:
            raise BlockRobotError("NOT_PERMITTED")
        return await honest(keys, session)

    monkeypatch.setattr(doctor, "values", refuse_bad)
    told = people.told(doctor, "inbox")
    assert [row["grant_id"] for row in told["received"]] == [good["grant_id"]]
    assert [(row["grant_id"], row["code"]) for row in told["unread"]] == [(bad["grant_id"], "NOT_PERMITTED")]
    said = people.run(doctor, "inbox").output
    assert f"{bad['grant_id'][:12]}  could not be read: This key may not do that." in said
    looked = people.run(doctor, "look", bad["grant_id"][:12])
    assert (looked.exit_code, "NOT_PERMITTED" in looked.output) == (4, True)


def test_the_inbox_of_her_who_shared_says_who_looked_and_what_was_found_changed(people: People, tmp_path: Path) -> None:
    ward = people.ward
    visit, (first, _) = ward.record_visit()
    asyncio.run(ward.share(people.doctor))
    (row,) = people.told(ward.wallet, "shares")["shares"]
    assert people.told(ward.wallet, "inbox")["looks"] == []
    people.told(people.doctor, "look", row["grant_id"][:8], "--out", tmp_path / "shared")
    (look,) = people.told(ward.wallet, "inbox")["looks"]
    assert (look["visit"], look["grant_id"], look["records"]) == (visit.owner.hex(), row["grant_id"], 2)
    assert "whom you shared with looked at 2 records" in people.run(ward.wallet, "inbox").output
    (entry,) = [entry for entry in asyncio.run(ward.entries()) if entry.record_id == first]
    asyncio.run(ward.wallet.sign_and_wait(entry.visit, "access", "verdict", [[[first, "corrupted", [0]]]]))
    told = people.told(ward.wallet, "inbox")
    assert told["changed_records"] == [first.hex()]
    assert "picture 1 did not pass every check" in people.run(ward.wallet, "inbox").output
    asyncio.run(ward.wallet.sign_and_wait(entry.visit, "access", "verdict", [[[first, "corrupted", [0, 1]]]]))
    assert "pictures 1, 2 did not pass every check" in people.run(ward.wallet, "inbox").output
    asyncio.run(ward.wallet.sign_and_wait(entry.visit, "access", "verdict", [[[first, "corrupted", []]]]))
    said = " ".join(people.run(ward.wallet, "inbox").output.split())
    assert f"Record {first.hex()} did not pass every check, as you found" in said, "the robot's count alone is wrong"


def test_one_restricted_record_is_named_and_the_others_are_fetched_for_their_readers_eyes_alone(
    people: People, tmp_path: Path
) -> None:
    ward = people.ward
    _, (barred, free) = ward.record_visit()
    asyncio.run(ward.share(people.doctor))
    (row,) = people.told(ward.wallet, "shares")["shares"]

    async def restrict() -> None:
        (entry,) = [entry for entry in await ward.entries() if entry.record_id == barred]
        await Rights(ward.wallet).restrict(RecordChoice(entry.visit, (entry,)), "accuracy")

    asyncio.run(restrict())
    out = tmp_path / "shared"
    told = people.told(people.doctor, "look", row["grant_id"][:8], "--out", out)
    assert ([each["record_id"] for each in told["records"]], told["restricted"]) == ([free.hex()], [barred.hex()])
    assert f"{barred.hex()}: left out" in people.run(people.doctor, "look", row["grant_id"][:8], "--out", out).output
    written = list((out / free.hex()).iterdir())
    assert {path.stat().st_mode & 0o777 for path in written} == {0o600}
    assert (out / free.hex()).stat().st_mode & 0o777 == 0o700
    named = people.run(people.doctor, "look", row["grant_id"][:8], barred.hex(), "--out", out)
    assert (named.exit_code, "RECORD_RESTRICTED" in named.output) == (4, True)


def fail_at_second_grant(people: People, monkeypatch: pytest.MonkeyPatch, *more: str) -> Result:
    """Share two records, one a grant, with a custodian that goes away between the two."""
    ward = people.ward
    visit, _ = ward.record_visit()
    monkeypatch.setattr(outgoing_shares, "GRANT_RECORDS_MAX_COUNT", 1)
    honest = ward.sharing.__class__.share

    async def share_once(*given: Any) -> Any:
        shared = await honest(*given)
        ward.custody.away = {"custodian-1"}
        return shared

    monkeypatch.setattr(share_commands.Sharing, "share", share_once)
    handle = people.doctor.store.content.handle.hex()
    arguments = ["--visit", visit.owner.hex()[:12], "--with", handle, "--purpose", "care", "--for", "7d", "--yes"]
    return people.run(ward.wallet, "share", *arguments, *more)


def test_a_failure_at_a_second_grant_tells_of_the_first(people: People, monkeypatch: pytest.MonkeyPatch) -> None:
    failed = fail_at_second_grant(people, monkeypatch)
    assert "SHARE_CUSTODIANS_MISSING" in failed.output
    (row,) = people.told(people.ward.wallet, "shares")["shares"]
    assert failed.exit_code == 1
    assert (
        f"1 record is shared already, until you end it (blockrobot wallet revoke: {row['grant_id'][:12]})"
        in failed.output
    )


def test_how_long_is_said_in_one_of_two_ways() -> None:
    now_ms = 1_700_000_100_000
    assert read_end("7d", None, now_ms) - now_ms - WEEK_MS < GRANT_STEP_MS
    assert read_end("90m", None, now_ms) - now_ms - 90 * 60_000 < GRANT_STEP_MS
    tomorrow = datetime.datetime.fromtimestamp(now_ms / 1000 + 86_400, datetime.UTC).isoformat()
    assert abs(read_end(None, tomorrow, now_ms) - now_ms - 86_400_000) < GRANT_STEP_MS
    for wrong in ((None, None), ("7d", tomorrow), ("a week", None), ("7", None), (None, "soon")):
        with pytest.raises(click.UsageError):
            read_end(*wrong, now_ms)
    with pytest.raises(click.UsageError, match="one of them, not both"):
        read_end("7d", tomorrow, now_ms)


# In Portuguese


@pytest.fixture
def pessoas(people: People, monkeypatch: pytest.MonkeyPatch) -> People:
    monkeypatch.setenv(LANGUAGE_VARIABLE, "pt")
    return people


def test_sharing_is_explained_asked_and_told_in_portuguese(pessoas: People, monkeypatch: pytest.MonkeyPatch) -> None:
    _, (record_id,) = pessoas.ward.record_visit(1)
    asked: list[str] = []
    monkeypatch.setattr(share_commands, "ask_or_say", lambda question, *, yes, told: asked.append(f"{told} {question}"))
    done = pessoas.share(record_id)
    (told,) = asked
    for part in (
        "Partilha 1 gravação, 2 imagens ou sons, profundidade (depth)",
        "Dr Weber, membro do pessoal de ward",
        "Cuidado e",
    ):
        assert part in told
    for part in ("O que a outra pessoa vê", "não se pode desfazer", "não com quem", "Partilhar isto?"):
        assert part in told
    assert "Partilhado com Dr Weber, membro do pessoal de ward" in done.output
    assert "Para terminar: blockrobot wallet revoke" in done.output


def test_shares_their_end_and_ones_handle_are_told_in_portuguese_and_json_is_the_same(
    pessoas: People, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ward, ann = pessoas.ward, pessoas.ward.wallet
    visit, (record_id,) = ward.record_visit(1)
    assert "Não partilhou nada." in pessoas.run(ann, "shares").output
    pessoas.share(record_id, "--yes")
    told = pessoas.told(ann, "shares")
    assert (told["shares"][0]["status"], told["shares"][0]["name"]) == ("open", "Dr Weber")
    monkeypatch.setenv(LANGUAGE_VARIABLE, "en")
    assert pessoas.told(ann, "shares") == told
    monkeypatch.setenv(LANGUAGE_VARIABLE, "pt")
    name = told["shares"][0]["grant_id"][:12]
    lines = pessoas.run(ann, "shares").output
    assert f"{name}  1 gravação do encontro {visit.owner.hex()[:12]}, com Dr Weber (identificador " in lines
    assert "para cuidados (care): até " in lines
    assert "ninguém viu" in lines
    pessoas.run(pessoas.doctor, "look", name, "--out", tmp_path / "shared")
    assert ": 1 gravação podia então ser obtida" in pessoas.run(ann, "shares").output
    assert "para cuidados (care) (partilha " in pessoas.run(ann, "inbox").output
    ended = pessoas.run(ann, "revoke", name).output
    assert "Terminado: 1 gravação já não está partilhada com Dr Weber (identificador " in ended
    assert "Foi vista antes." in ended
    assert "Já tinha terminado essa partilha" in pessoas.run(ann, "revoke", name).output
    assert "terminada por si" in pessoas.run(ann, "shares").output
    visitor = ward.come_in("visitor", "subject")
    assert "Está inscrito como utente: só se partilha com o pessoal" in pessoas.run(visitor, "handle").output


def test_the_inbox_looking_and_confirming_are_told_in_portuguese(
    pessoas: People, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ward, doctor, out = pessoas.ward, pessoas.doctor, tmp_path / "shared"
    assert "Nada foi partilhado consigo" in pessoas.run(doctor, "inbox").output
    visit, (first, second) = ward.record_visit()
    asyncio.run(ward.share(doctor))
    told = pessoas.told(doctor, "inbox")
    name = told["received"][0]["grant_id"][:12]
    said = pessoas.run(doctor, "inbox").output
    assert f"{name}  2 gravações do encontro {visit.owner.hex()[:12]}, até " in said
    assert "Para: Cuidado e tratamento da própria pessoa." in said
    assert f"Para ver: blockrobot wallet look {name}" in said
    looked = pessoas.run(doctor, "look", name, "--out", out).output
    assert f"{first.hex()}: 2 de 2 imagens estão como o robô as captou." in looked
    assert f"As imagens estão em {out}." in looked
    asyncio.run(ward.erase(visit, [first]))
    said = pessoas.run(doctor, "inbox").output
    for part in ("1 de 2 gravações: foi apagada, ou passou o prazo: elimine todas as cópias", "há uma cópia em "):
        assert part in said
    assert f"Quando já não restar nada: blockrobot wallet confirm-deleted {name}" in said
    asked: list[str] = []
    monkeypatch.setattr(inbox_commands, "ask_or_say", lambda question, *, yes, told: asked.append(f"{told} {question}"))
    (out / first.hex() / "nota.txt").write_text("minha")
    done = pessoas.run(doctor, "confirm-deleted", name, "--delete").output
    assert "Eliminar o que `look` escreveu em 1 pasta, e dizer no registo" in asked[0]
    assert "nenhuma cópia de 1 gravação: nem noutro lugar" in asked[0]
    assert asked[0].endswith("É assim?")
    assert "fica: contém o que `look` não escreveu (nota.txt)." in done.replace("\n", "")
    assert "A dona vê agora que eliminou as suas cópias de 1 gravação." in done
    assert "Confirmou que eliminou as suas cópias" in pessoas.run(doctor, "inbox").output
    assert "diz que eliminou as cópias de 1 gravação" in pessoas.run(ward.wallet, "shares").output
    assert second.hex() not in asked[0]


def test_what_is_missing_of_ones_own_visits_is_told_in_portuguese(pessoas: People) -> None:
    ward = pessoas.ward
    visit = ward.open_visit()
    ward.record(visit)
    ward.chain.must(ward.chain.robot.identity, "records", "close_visit", visit.owner, 3)
    said = pessoas.run(ward.wallet, "inbox").output
    assert f"O seu encontro {visit.owner.hex()[:12]}: faltam 2 gravações. Pergunte porquê." in said


def test_every_notice_of_what_was_shared_has_its_words_in_both_languages() -> None:
    for language in LANGUAGES:
        for words in ("received.had", "received.never_had"):
            assert set(section(words, language)) == {*TO_DELETE, KIND_CORRECTED, KIND_RESTRICTED}


def test_what_is_shared_already_is_told_in_portuguese_and_to_programs_in_english(
    pessoas: People, monkeypatch: pytest.MonkeyPatch
) -> None:
    failed = fail_at_second_grant(pessoas, monkeypatch)
    assert "1 gravação já está partilhada, até que termine a partilha" in failed.output
    pessoas.ward.custody.away = set()
    with monkeypatch.context() as again:
        told = json.loads(fail_at_second_grant(pessoas, again, "--json").output)
    assert told["error"]["detail"].startswith("1 record is shared already, until you end it")


def test_an_erasure_names_in_portuguese_who_had_received_it(pessoas: People, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(erase_command, "ERASE_WAIT_S", -1.0)
    _, (record_id,) = pessoas.ward.record_visit(1)
    pessoas.share(record_id, "--yes")
    told = pessoas.run(pessoas.ward.wallet, "erase", record_id.hex(), "--yes").stdout
    assert "foram partilhadas com Dr Weber (identificador " in told
    assert "que não viu e é avisado do apagamento." in told


@pytest.mark.parametrize(
    ("step", "english", "portuguese"),
    [
        (STEP_KEYS, "fetching the keys", "a buscar as chaves"),
        (f"{STEP_PARTS}n1", "handing its parts to n1", "a entregar as suas partes a n1"),
        (STEP_SIGNING, "signing", "a assinar"),
    ],
)
def test_each_step_of_sharing_is_said_in_both_languages(
    step: str, english: str, portuguese: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for language, said in (("en", english), ("pt", portuguese)):
        monkeypatch.setenv(LANGUAGE_VARIABLE, language)
        assert say_step(step) == said

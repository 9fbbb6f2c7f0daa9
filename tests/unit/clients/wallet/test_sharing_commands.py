"""The commands of sharing: everything is said before it is asked for, and nothing is confirmed that is not so."""

from __future__ import annotations

import asyncio
import datetime
import json
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import Result

from clients.wallet.commands import erase_commands, share_commands
from clients.wallet.commands.share_commands import read_end, step_text
from clients.wallet.presentation.translations import LANGUAGE_VARIABLE, LANGUAGES, section
from clients.wallet.records.rights_requests import RecordChoice, Rights
from clients.wallet.sharing import outgoing_shares
from clients.wallet.sharing.incoming_shares import KIND_CORRECTED, KIND_RESTRICTED, TO_DELETE
from clients.wallet.sharing.outgoing_shares import STEP_KEYS, STEP_PARTS, STEP_SIGNING
from consensus.errors import BlockRobotError
from consensus.members.handles import encode_short
from consensus.records.sharing import GRANT_STEP_MS
from tests.world.commands import People, sit_at_terminal
from tests.world.sharing import WEEK_MS
from tests.world.transcripts import Transcript


@pytest.mark.parametrize("language", LANGUAGES)
def test_a_share_is_told_on_both_sides_from_its_plan_to_the_last_copy(
    people: People, transcript: Transcript, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, language: str
) -> None:
    monkeypatch.setenv(LANGUAGE_VARIABLE, language)
    sit_at_terminal(monkeypatch)
    ward, ann, doctor = people.ward, people.ward.wallet, people.doctor
    wallets = {"ann": ann, "doctor": doctor, "visitor": ward.come_in("visitor")}
    say = transcript.follow(lambda who, *typed, **more: people.run(wallets[who], *typed, **more))
    for who, command in (("doctor", "inbox"), ("ann", "shares"), ("doctor", "handle"), ("visitor", "handle")):
        say(who, command)
    visit, (first, _) = ward.record_visit()
    share = (
        "share",
        "--visit",
        visit.owner.hex()[:12],
        "--as",
        "Dr Weber",
        "--purpose",
        "care",
        "--for",
        "7d",
        "--with",
    )
    height, handle = ward.chain.height, doctor.store.content.handle.hex()
    say("ann", *share, wallets["visitor"].store.content.handle.hex(), "--yes")
    say("ann", *share, handle, typed="n\n")
    assert ward.chain.height == height, "nothing was shared"
    say("ann", *share, handle, typed="y\n")
    name, out = people.told(ann, "shares")["shares"][0]["grant_id"][:12], tmp_path / "shared"
    say("ann", "shares")
    say("doctor", "inbox")
    say("doctor", "look", name, "--out", out)
    for command in ("shares", "inbox"):
        say("ann", command)
    asyncio.run(ward.erase(visit, [first]))
    say("doctor", "inbox")
    (out / first.hex() / "mynote.txt").write_text("mine")
    say("doctor", "confirm-deleted", name, "--yes")
    say("doctor", "confirm-deleted", name, "--delete", typed="y\n")
    say("doctor", "confirm-deleted", name, "--yes")
    say("doctor", "inbox")
    say("ann", "shares")
    for _ in range(2):
        say("ann", "revoke", name)
    say("ann", "shares")
    say("doctor", "look", name, "--out", tmp_path / "again")
    say("doctor", "inbox")
    unlooked, records = ward.record_visit()
    people.run(ann, "share", "--visit", unlooked.owner.hex(), *share[3:], handle, "--yes")
    asyncio.run(ward.erase(unlooked, records))
    say("doctor", "inbox")
    transcript.compare(f"sharing.{language}")


@pytest.mark.parametrize("language", LANGUAGES)
def test_an_inbox_tells_what_is_wrong_with_ones_own_visits_and_an_erasure_who_had_received_it(
    people: People, transcript: Transcript, monkeypatch: pytest.MonkeyPatch, language: str
) -> None:
    """No custodian confirms in time: she hears that, and with whom she had shared it."""
    monkeypatch.setenv(LANGUAGE_VARIABLE, language)
    monkeypatch.setattr(erase_commands, "WAIT_MAX_S", -1.0)
    ward, ann = people.ward, people.ward.wallet
    say = transcript.follow(lambda *typed: people.run(ann, *typed), "ann")
    visit = ward.open_visit()
    record_id = ward.record(visit)
    ward.chain.must(ward.chain.robot.identity, "records", "close_visit", visit.owner, 3)
    say("inbox")
    (entry,) = asyncio.run(ward.entries())
    for numbers in ([0], [0, 1], []):
        asyncio.run(ann.sign_and_wait(entry.visit, "access", "verdict", [[[record_id, "corrupted", numbers]]]))
        say("inbox")
    people.share(record_id, "--yes")
    say("erase", record_id.hex(), "--wait", "--yes")
    transcript.compare(f"inbox.{language}")
    told = people.told(ann, "inbox")
    assert [(row["visit"], row["missing_records"]) for row in told["alarms"]] == [(visit.owner.hex(), 2)]
    assert set(told["changed_records"]) == {record_id.hex()}


def test_without_a_terminal_nothing_is_shared_unless_yes_is_said(people: People) -> None:
    _, (record_id,) = people.ward.record_visit(1)
    height = people.ward.chain.height
    refused = people.share(record_id)
    assert (refused.exit_code, "--yes" in refused.output) == (2, True)
    assert people.ward.chain.height == height


def test_the_whole_story_as_programs_hear_it_the_same_in_each_language(
    people: People, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ward, ann, doctor = people.ward, people.ward.wallet, people.doctor
    visit, (record_id,) = ward.record_visit(1)
    assert people.told(doctor, "handle")["handle"] == doctor.store.content.handle.hex()
    people.share(record_id, "--yes")
    (row,) = people.told(ann, "shares")["shares"]
    assert (row["name"], row["status"], row["looks"], row["until_ms"] % GRANT_STEP_MS) == ("Dr Weber", "open", [], 0)
    name, out = row["grant_id"][:12], tmp_path / "shared"
    assert people.told(ann, "inbox")["looks"] == []
    people.told(doctor, "look", name, "--out", out)
    assert len(list((out / record_id.hex()).glob("*.depth.png"))) == 2
    (row,) = people.told(ann, "shares")["shares"]
    assert len(row["looks"]) == 1
    (look,) = people.told(ann, "inbox")["looks"]
    assert (look["visit"], look["grant_id"], look["records"]) == (visit.owner.hex(), row["grant_id"], 1)
    monkeypatch.setenv(LANGUAGE_VARIABLE, "pt")
    assert people.told(ann, "shares")["shares"] == [row]
    asyncio.run(ward.erase(visit, [record_id]))
    assert people.run(doctor, "confirm-deleted", name, "--yes").exit_code == 1, "copies remain"
    assert people.told(doctor, "confirm-deleted", name, "--yes", "--delete")["records"] == [record_id.hex()]
    assert not (out / record_id.hex()).exists()
    assert people.told(ann, "shares")["shares"][0]["confirmed_deleted"] == [record_id.hex()]
    assert people.run(doctor, "confirm-deleted", name, "--yes").exit_code == 3, "nothing is left to confirm"
    assert people.told(ann, "revoke", name)["already_ended"] is False
    told = people.told(ann, "revoke", name)
    assert (told["already_ended"], told["txid"]) == (True, None)


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


def test_a_program_hears_of_a_late_erasure_who_had_received_it(people: People, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(erase_commands, "WAIT_MAX_S", -1.0)
    _, (record_id,) = people.ward.record_visit(1)
    people.share(record_id, "--yes")
    told = people.run(people.ward.wallet, "erase", record_id.hex(), "--wait", "--yes", "--json")
    answer = json.loads(told.stdout)
    assert (told.exit_code != 0, answer["ok"], answer["error"]["code"]) == (True, False, "ERASURE_NOT_CONFIRMED")
    assert (answer["recipients"][0]["name"], len(answer["erasures"])) == ("Dr Weber", 1)


def test_the_command_that_an_inbox_names_can_be_typed_as_it_stands(people: People) -> None:
    people.ward.record_visit()
    asyncio.run(people.ward.share(people.doctor))
    for arguments, said in (((), ""), (("--profile", "doctor"), " --profile doctor")):
        result = people.run(people.doctor, *arguments, "inbox")
        assert f"blockrobot wallet{said} look " in result.output.replace("\n", " "), result.output


def test_the_command_that_ends_a_share_is_that_of_the_wallet_that_made_it(people: People) -> None:
    _, (record_id,) = people.ward.record_visit(1)
    handle = people.doctor.store.content.handle.hex()
    arguments = ["share", record_id.hex(), "--with", handle, "--purpose", "care", "--for", "7d", "--yes"]
    done = people.run(people.ward.wallet, "--profile", "anna", *arguments)
    (row,) = people.told(people.ward.wallet, "shares")["shares"]
    assert f"To end it: blockrobot wallet --profile anna revoke {row['grant_id'][:12]}" in done.output


def test_who_never_looked_has_nothing_to_delete(people: People) -> None:
    ward, doctor = people.ward, people.doctor
    visit, records = ward.record_visit()
    asyncio.run(ward.share(doctor))
    asyncio.run(ward.erase(visit, records))
    (row,) = people.told(doctor, "inbox")["received"]
    assert (row["open"], row["looked"], row["to_look"]) == (True, False, [])
    refused = people.run(doctor, "confirm-deleted", row["grant_id"][:12], "--yes")
    assert (refused.exit_code, "You never looked at it" in refused.output) == (3, True)


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

    monkeypatch.setattr(share_commands.SharingClient, "share", share_once)
    handle = people.doctor.store.content.handle.hex()
    arguments = ["--visit", visit.owner.hex()[:12], "--with", handle, "--purpose", "care", "--for", "7d", "--yes"]
    return people.run(ward.wallet, "share", *arguments, *more)


def test_a_failure_at_a_second_grant_tells_of_the_first(people: People, monkeypatch: pytest.MonkeyPatch) -> None:
    failed = fail_at_second_grant(people, monkeypatch)
    assert (failed.exit_code, "SHARE_CUSTODIANS_MISSING" in failed.output) == (1, True)
    (row,) = people.told(people.ward.wallet, "shares")["shares"]
    told = "1 record is shared already, until you end it"
    assert f"{told} (blockrobot wallet revoke: {row['grant_id'][:12]})" in failed.output
    monkeypatch.setenv(LANGUAGE_VARIABLE, "pt")
    for more, said in (((), "1 gravação já está partilhada, até que termine a partilha"), (("--json",), told)):
        people.ward.custody.away = set()
        with monkeypatch.context() as again:
            assert said in fail_at_second_grant(people, again, *more).output


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


def test_every_notice_of_what_was_shared_has_its_words_in_both_languages() -> None:
    for language in LANGUAGES:
        for words in ("received.had", "received.never_had"):
            assert set(section(words, language)) == {*TO_DELETE, KIND_CORRECTED, KIND_RESTRICTED}


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
        assert step_text(step) == said


def test_a_short_handle_leads_to_the_same_member_and_a_mistyped_one_to_nobody(people: People, tmp_path: Path) -> None:
    _, (record_id,) = people.ward.record_visit(1)
    doctor, told = people.doctor, people.told(people.doctor, "handle")
    assert told["short"] == encode_short(doctor.store.content.handle)
    assert people.run(doctor, "handle").output.split()[0] == told["short"]
    share = [record_id.hex(), "--purpose", "care", "--for", "7d", "--yes", "--as", "Dr Weber"]
    wrong = told["short"][:-1] + ("q" if told["short"][-1] != "q" else "p")
    refused = people.run(people.ward.wallet, "share", *share, "--with", wrong)
    assert (refused.exit_code, "HANDLE_MISTYPED" in refused.output) == (2, True)
    nobody = people.run(people.ward.wallet, "share", *share, "--with", encode_short(bytes(32)))
    assert "SHARE_WITH_NON_MEMBER" in nobody.output
    (tmp_path / "doctor.txt").write_text(f"{told['short']}\n")
    shared = people.told(people.ward.wallet, "share", *share, "--with", f"@{tmp_path}/doctor.txt")
    assert shared["handle"] == told["handle"]


def test_after_one_picture_was_erased_both_sides_are_told_that_the_share_is_over_and_nothing_contradicts_it(
    people: People, tmp_path: Path
) -> None:
    ward, ann, doctor = people.ward, people.ward.wallet, people.doctor
    visit, (record_id,) = ward.record_visit(1)
    people.share(record_id, "--yes")
    name = people.told(ann, "shares")["shares"][0]["grant_id"][:12]
    people.run(doctor, "look", name, "--out", tmp_path / "shared")
    asyncio.run(ward.erase(visit, [record_id], [1]))
    said = people.run(ann, "shares").output
    assert "care: nothing of it is shared any more" in said
    assert "of 1 record single pictures were erased since: it is shared no more" in said
    assert "1 record could be fetched then" in said
    for part in ("until", "may be fetched", "To end it"):
        assert part not in said
    height = ward.chain.height
    for more in ((), (record_id.hex()[:8],)):
        refused = people.run(doctor, "look", name, *more, "--out", tmp_path / "again")
        assert (refused.exit_code, "GRANT_ENDED" in refused.output) == (3, True), refused.output
        assert "Single pictures of it were erased since it was shared, which ends the share." in refused.output
        assert "Everything" not in refused.output
        assert "erasures" not in refused.output, "the receipts are the owner's"
    assert ward.chain.height == height, "no look stands on the ledger that could see nothing"


def test_after_the_whole_record_was_erased_nobody_speaks_of_single_pictures(people: People) -> None:
    ward, ann, doctor = people.ward, people.ward.wallet, people.doctor
    visit, (first, second) = ward.record_visit()
    asyncio.run(ward.share(doctor))
    asyncio.run(ward.erase(visit, [first], [1]))
    asyncio.run(ward.erase(visit, [first]))
    (row,) = people.told(ann, "shares")["shares"]
    assert (row["cut"], row["erased"]) == ([], [first.hex()])
    said = people.run(ann, "shares").output
    assert "1 record was erased since: it is shared no more" in said
    assert "single pictures" not in said
    assert "until" in said, "the other record is still shared"
    asyncio.run(ward.erase(visit, [second]))
    refused = people.run(doctor, "look", row["grant_id"][:12])
    assert (refused.exit_code, "GRANT_ENDED" in refused.output) == (3, True), refused.output
    assert "All of it was erased since it was shared." in refused.output

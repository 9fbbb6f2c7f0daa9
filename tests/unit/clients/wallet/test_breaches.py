"""What an officer sees of breaches, and what is done in her name; and both groups of commands as people call them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import pytest
from click.testing import CliRunner, Result

from clients.officer import breach_commands
from clients.officer.breaches import Breaches, breach_answer
from clients.wallet.cli import main as wallet_cli
from clients.wallet.presentation.translations import LANGUAGE_VARIABLE, LANGUAGES
from clients.wallet.records.rights_requests import Rights, write_correction
from consensus.errors import BlockRobotError
from consensus.rights.right_codes import BREACH_NOTIFY_MS, Correction, commit_correction
from consensus.state.rights import (
    BREACH,
    BREACH_COUNT,
    BREACH_NUMBER,
    CORRECTION,
    CORRECTION_COUNT,
    QUARANTINE,
    RESTRICTION,
    AssessedRow,
    BreachRow,
    ClosedRow,
    CorrectionRow,
    NotifiedRow,
    RestrictionRow,
)
from tests.world.commands import open_for_commands
from tests.world.dicts import NOW_MS, ROBOT, Saying, World
from tests.world.transcripts import Transcript

OFFICER = b"\x02" * 33
FIRST, SECOND = b"\xb1" * 32, b"\xb2" * 32


@dataclass(frozen=True)
class Header:
    timestamp_ms: int


def put_breach(world: World, breach_id: bytes, number: int, owner: bytes, **changes: Any) -> None:
    due_ms = NOW_MS + BREACH_NOTIFY_MS
    row = BreachRow(
        number,
        owner,
        ROBOT,
        "hospital",
        "wrong-person",
        "opened",
        "",
        NOW_MS,
        due_ms,
        assessed=None,
        notified={},
        closed=None,
    )
    world.put(BREACH, msgspec.structs.replace(row, **changes), breach_id)
    world.put(BREACH_NUMBER, breach_id, number)
    world.network.state[BREACH_COUNT.flat] = number + 1


@pytest.fixture
def clock(world: World, monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The time of the newest block, which a test may change."""
    now = [NOW_MS]

    async def newest_header(_: Any) -> Header:
        return Header(now[0])

    monkeypatch.setattr(world.network, "newest_header", newest_header, raising=False)
    return now


@pytest.fixture
def saying(world: World, monkeypatch: pytest.MonkeyPatch) -> Saying:
    told = {"height": 8, "until_ms": NOW_MS, "number": 0, "breach_id": FIRST, "due_ms": NOW_MS, "org": "hospital"}
    saying = Saying(told)
    monkeypatch.setattr(world.network, "call", saying)
    return saying


ASSESSED = AssessedRow(NOW_MS, OFFICER, "matched-wrongly")
TOLD = NotifiedRow(NOW_MS, OFFICER, "", late=False)


async def test_the_clock_is_the_chains_and_says_who_is_overdue(world: World, clock: list[int]) -> None:
    put_breach(world, FIRST, 0, b"o" * 33)
    put_breach(world, SECOND, 1, b"p" * 33, status="assessed", risk="none", assessed=ASSESSED)
    clock[0] = NOW_MS + BREACH_NOTIFY_MS - 1000
    first, second = await Breaches(world.wallet).read_all()
    assert (first.left_ms, first.is_overdue, second.is_overdue) == (1000, False, False)
    clock[0] += 2000
    first, second = await Breaches(world.wallet).read_all()
    assert (first.left_ms, first.is_overdue, second.is_overdue) == (-1000, True, False), "none has to be told of none"
    shown = breach_answer(second)
    assert (shown.assessed and shown.assessed.officer, shown.risk) == (OFFICER.hex(), "none")
    msgspec.json.encode(breach_answer(first))


async def test_a_breach_is_named_by_a_beginning_that_is_its_own(world: World, clock: list[int]) -> None:
    assert clock
    put_breach(world, FIRST, 0, b"o" * 33)
    assert (await Breaches(world.wallet).find("b1" * 4)).breach_id == FIRST
    for start, code in (("b1", "NAME_TOO_SHORT"), ("cc" * 6, "BREACH_NOT_FOUND")):
        with pytest.raises(BlockRobotError, match=rf"^{code}:"):
            await Breaches(world.wallet).find(start)


async def test_closing_as_erased_orders_every_record_in_parts(world: World, clock: list[int], saying: Saying) -> None:
    assert clock
    visit = world.open_visit()
    ids = [number.to_bytes(16, "big") for number in range(130)]
    for number, record_id in enumerate(ids):
        status = "erased" if number == 3 else "active"
        world.put_record(record_id, visit.owner, status=status)
        world.append_audit(visit.owner, "recorded", record_id)
    world.append_audit(visit.owner, "denied")
    put_breach(world, FIRST, 0, visit.owner, status="assessed", risk="none", assessed=ASSESSED)
    handling = Breaches(world.wallet)
    progress: list[tuple[int, int]] = []
    count = await handling.close(
        await handling.find("b1" * 4),
        "erased",
        "matched-wrongly",
        lambda number, all_of: progress.append((number, all_of)),
    )
    *orders, end = [(entry, arguments) for _, entry, arguments in saying.said]
    assert count == 129
    assert progress == [(0, 129), (64, 129), (128, 129)]
    assert [entry for entry, _ in orders] == ["rights.order_erasure"] * 3
    assert [record_id for _, arguments in orders for record_id in arguments[1]] == [*ids[:3], *ids[4:]]
    assert end == ("rights.close", [FIRST, "erased", "matched-wrongly"])
    assert {key for key, _, _ in saying.said} == {world.keys.identity.public_key}


async def test_what_comes_after_an_end_as_erased_is_erased_by_saying_it_again(
    world: World, clock: list[int], saying: Saying
) -> None:
    assert clock
    visit = world.open_visit()
    late = b"l" * 16
    world.put_record(late, visit.owner)
    world.append_audit(visit.owner, "recorded", late)
    put_breach(world, FIRST, 0, visit.owner, status="closed", risk="none", assessed=ASSESSED)
    handling = Breaches(world.wallet)
    found = await handling.find("b1" * 4)
    assert await handling.close(found, "erased", "matched-wrongly", lambda *_: None) == 1
    assert [(entry, arguments) for _, entry, arguments in saying.said] == [("rights.order_erasure", [FIRST, [late]])], (
        "it is closed already"
    )


@pytest.mark.parametrize(
    ("risk", "notified", "assessed"),
    [("", {}, None), ("risk", {}, ASSESSED), ("high", {"authority": TOLD}, ASSESSED)],
)
async def test_nothing_is_erased_of_a_breach_that_cannot_be_closed_yet(
    world: World, clock: list[int], saying: Saying, risk: str, notified: dict[str, Any], assessed: AssessedRow | None
) -> None:
    assert clock
    visit = world.open_visit()
    world.put_record(b"r" * 16, visit.owner)
    world.append_audit(visit.owner, "recorded", b"r" * 16)
    put_breach(world, FIRST, 0, visit.owner, status="assessed", risk=risk, notified=notified, assessed=assessed)
    handling = Breaches(world.wallet)
    with pytest.raises(BlockRobotError, match="BREACH_NOT_"):
        await handling.close(await handling.find("b1" * 4), "erased", "matched-wrongly", lambda *_: None)
    assert saying.said == []


# As people call them


@pytest.fixture
def run(world: World, clock: list[int], saying: Saying, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Call a command on this wallet."""
    assert clock
    assert saying

    open_for_commands(monkeypatch, lambda: world.wallet)

    def call(*arguments: str) -> Result:
        group = breach_commands.officer if arguments[0] == "officer" else wallet_cli.wallet
        return CliRunner().invoke(group, list(arguments[1:]))

    return call


@pytest.mark.parametrize("language", LANGUAGES)
def test_a_patient_restricts_lifts_objects_corrects_and_denies(
    world: World, run: Any, tmp_path: Path, transcript: Transcript, monkeypatch: pytest.MonkeyPatch, language: str
) -> None:
    visit = world.open_visit()
    record_id = world.record(visit).upload.record_id.hex()
    (tmp_path / "right.txt").write_text("É a minha irmã.\n", encoding="utf-8")
    name, text, out = visit.owner.hex()[:12], str(tmp_path / "right.txt"), tmp_path / "correction.json"
    for arguments in (
        ("restrict", "--visit", name, "--ground", "legal-claim"),
        ("lift", record_id),
        ("object", "--purpose", "demo", "--now"),
        ("correct", "--visit", name, "--text-file", text, "--out", str(out)),
        ("wrong-person", name, "--yes"),
    ):
        monkeypatch.setenv(LANGUAGE_VARIABLE, language)
        transcript.follow(run)("wallet", *arguments)
        answers = []
        for spoken in LANGUAGES:
            out.unlink(missing_ok=True)
            monkeypatch.setenv(LANGUAGE_VARIABLE, spoken)
            answers.append(json.loads(run("wallet", *arguments, "--json").stdout))
        assert answers[0]["ok"] is True
        assert answers[0].keys() == answers[1].keys()
    transcript.compare(f"rights.{language}")


def test_a_correction_is_for_its_writer_alone(world: World, run: Any, tmp_path: Path) -> None:
    (tmp_path / "right.txt").write_text("That is my sister.\n", encoding="utf-8")
    name, out = world.open_visit().owner.hex(), tmp_path / "correction.json"
    run("wallet", "correct", "--visit", name, "--text-file", str(tmp_path / "right.txt"), "--out", str(out))
    assert json.loads(out.read_text(encoding="utf-8"))["text"] == "That is my sister."
    assert out.stat().st_mode & 0o777 == 0o600


def test_a_correction_is_written_to_a_new_file_or_not_said(
    world: World, run: Any, tmp_path: Path, saying: Saying
) -> None:
    text, out = tmp_path / "right.txt", tmp_path / "correction.json"
    text.write_text("That is my sister.", encoding="utf-8")
    out.write_text("another's", encoding="utf-8")
    words = ("correct", "--visit", world.open_visit().owner.hex(), "--text-file", str(text), "--out", str(out))
    refused = run("wallet", *words)
    assert (refused.exit_code != 0, "FILE_EXISTS" in refused.stderr, saying.said) == (True, True, [])
    assert out.read_text(encoding="utf-8") == "another's"
    out.unlink()
    saying.refusal = "CALL_REFUSED"
    assert run("wallet", *words).exit_code != 0
    assert not out.exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("restrict", "--ground", "accuracy"), "Name records, or a whole visit"),
        (("restrict", "--visit", "02ab34cd"), "--ground"),
        (("lift",), "blockrobot wallet records"),
        (("object",), "--purpose CODE, one of"),
        (("correct", "--visit", "02ab34cd"), "--text-file"),
        (("wrong-person", "02ab34cd"), "--yes"),
    ],
)
def test_what_is_left_out_is_asked_for(run: Any, arguments: tuple[str, ...], words: str) -> None:
    result = run("wallet", *arguments)
    assert (result.exit_code, words in result.output) == (2, True), result.output


def test_a_correction_is_of_one_visit(world: World, run: Any, tmp_path: Path) -> None:
    (tmp_path / "right.txt").write_text("x", encoding="utf-8")
    names = [world.open_visit().owner.hex() for _ in range(2)]
    result = run(
        "wallet", "correct", "--visit", names[0], "--visit", names[1], "--text-file", str(tmp_path / "right.txt")
    )
    assert (result.exit_code, "of one visit" in result.output) == (2, True)


def test_what_was_restricted_before_a_refusal_is_told(world: World, run: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    names = [world.open_visit().owner.hex() for _ in range(2)]
    say, said = Rights.restrict, []

    async def once(rights: Rights, chosen: Any, ground: str) -> Any:
        if said:
            raise BlockRobotError("CALL_REFUSED", "RESTRICTION_STANDS")
        said.append(chosen.visit.owner.hex())
        return await say(rights, chosen, ground)

    monkeypatch.setattr(Rights, "restrict", once)
    words = ("restrict", "--visit", names[0], "--visit", names[1], "--ground", "accuracy", "--now")
    result = run("wallet", *words)
    assert (result.exit_code != 0, "RESTRICTION_STANDS" in result.stderr) == (True, True)
    assert f"Done before the refusal, and final: all of visit {said[0][:12]}." in result.stderr


def test_what_is_not_hers_is_named_with_the_next_step(world: World, run: Any) -> None:
    world.open_visit()
    result = run("wallet", "restrict", "00" * 16, "--ground", "accuracy")
    assert (result.exit_code, "RECORD_NOT_FOUND. Next step: `blockrobot wallet records`" in result.stderr) == (3, True)


@pytest.mark.parametrize("language", LANGUAGES)
def test_records_and_audit_say_what_stands(
    world: World, run: Any, transcript: Transcript, monkeypatch: pytest.MonkeyPatch, language: str
) -> None:
    monkeypatch.setenv(LANGUAGE_VARIABLE, language)
    visit = world.open_visit()
    world.record(visit)
    world.append_audit(visit.owner, "restricted", data={"ground": "legal-claim", "until_ms": 5})
    world.put(RESTRICTION, RestrictionRow("accuracy", True, 0, 0, [], NOW_MS), visit.owner)
    world.put(QUARANTINE, FIRST, visit.owner)
    say = transcript.follow(run)
    for command in ("records", "audit", "view"):
        say("wallet", command)
    transcript.compare(f"restricted.{language}")
    (shown,) = json.loads(run("wallet", "records", "--json").stdout)["visits"]
    assert (shown["restriction"]["ground"], shown["breach_id"]) == ("accuracy", FIRST.hex())
    assert [entry["restricted"] for entry in shown["records"]] == [True]
    _, entry = json.loads(run("wallet", "audit", "--json").stdout)["entries"]
    assert (entry["kind"], entry["detail"]) == ("restricted", "ground: legal-claim, kept beyond its time")


def test_an_officer_sees_the_clock_and_the_next_step(world: World, clock: list[int], run: Any) -> None:
    assert "There is no open breach." in run("officer", "breaches").output
    put_breach(world, FIRST, 0, b"o" * 33)
    closed = ClosedRow(NOW_MS, OFFICER, "erased", "matched-wrongly")
    put_breach(world, SECOND, 1, b"p" * 33, status="closed", risk="none", assessed=ASSESSED, closed=closed)
    clock[0] += BREACH_NOTIFY_MS // 2
    spoken = run("officer", "breaches").output
    assert "36.0 hours left to tell the authority" in spoken
    assert "Next: blockrobot officer assess b1b1b1b1b1b1 --risk RISK --reason CODE" in spoken
    assert "b2b2" not in spoken
    assert "Next: blockrobot officer --profile eva assess" in run("officer", "--profile", "eva", "breaches").output
    assert len(json.loads(run("officer", "breaches", "--all", "--json").stdout)["breaches"]) == 2


def test_a_correction_that_was_handed_over_is_checked(world: World, run: Any, tmp_path: Path) -> None:
    visit = world.open_visit()
    correction = Correction("attribution", "That is [red]my sister.", "ab" * 32, visit.owner.hex(), ["01" * 16])
    row = CorrectionRow([b"\x01" * 16], "attribution", commit_correction(correction), b"", FIRST, NOW_MS, 5)
    world.put(CORRECTION_COUNT, 1, visit.owner)
    world.put(CORRECTION, row, visit.owner, 0)
    file = tmp_path / "correction.json"
    file.write_bytes(write_correction(correction))
    spoken = run("officer", "correction", str(file))
    assert (spoken.exit_code, "That is [red]my sister." in spoken.output) == (0, True), spoken.output
    assert json.loads(run("officer", "correction", str(file), "--json").stdout)["height"] == 5
    file.write_bytes(write_correction(correction).replace(b"sister", b"mother"))
    assert "CORRECTION_UNPROVEN" in run("officer", "correction", str(file)).stderr
    file.write_bytes(write_correction(correction).replace(b"abab", b"xyxy"))
    assert "FILE_UNUSABLE" in run("officer", "correction", str(file)).stderr


@pytest.mark.parametrize(
    ("state", "step"),
    [
        ({"risk": "risk"}, "notify b1b1b1b1b1b1 --whom authority"),
        ({"risk": "high", "notified": {"authority": TOLD}}, "notify b1b1b1b1b1b1 --whom subjects"),
        ({"risk": "none"}, "close b1b1b1b1b1b1"),
    ],
)
def test_the_next_step_follows_the_risk(world: World, clock: list[int], run: Any, state: Any, step: str) -> None:
    put_breach(world, FIRST, 0, b"o" * 33, status="assessed", assessed=ASSESSED, **state)
    clock[0] += BREACH_NOTIFY_MS + 3_600_000
    spoken = run("officer", "breaches").output
    assert step in spoken
    assert ("1.0 hours over the 72" in spoken) == (step.endswith("authority"))


def test_an_officer_assesses_notes_and_closes(world: World, run: Any, saying: Saying) -> None:
    put_breach(world, FIRST, 0, b"o" * 33)
    for arguments in (
        ("assess", "b1b1b1b1", "--risk", "none", "--reason", "matched-wrongly"),
        ("notify", "b1b1b1b1", "--whom", "authority"),
        ("close", "b1b1b1b1", "--outcome", "released", "--reason", "owner-confirmed"),
    ):
        assert run("officer", *arguments).exit_code == 0
        assert json.loads(run("officer", *arguments, "--json").stdout)["breach_id"] == FIRST.hex()
    assert [entry for _, entry, _ in saying.said][::2] == ["rights.assess", "rights.notify", "rights.close"]

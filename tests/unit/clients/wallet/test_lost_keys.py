"""Two officers erase for somebody whose key is lost, as they do it: previews, commands, and what wallets tell of it.

The contracts are the real ones and everything is proven; only the wire is short.
"""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from clients.officer import breach_commands, lost_keys_commands
from clients.officer.lost_keys import LostKeys, make_span
from clients.wallet.cli import main as wallet_cli
from clients.wallet.presentation.translations import LANGUAGE_VARIABLE, LANGUAGES
from consensus.errors import BlockRobotError
from consensus.rights.right_codes import LOST_KEY_CARRY_OUT_MS
from tests.unit.contracts.privacy.hospital import Visit
from tests.world.commands import open_for_commands, sit_at_terminal
from tests.world.transcripts import Transcript
from tests.world.ward import Ward

BUCKET_MS = 300_000
DAY_MS = 24 * 3600 * 1000


class LostKeyHarness:
    """A ward with a patient who lost nothing, one who did, and two officers with wallets."""

    def __init__(self, folder: Path) -> None:
        self.ward = Ward(folder)
        self.chain = self.ward.chain
        self.wire = self.ward.network
        self.patient = self.ward.wallet
        self.officers = [self.ward.come_in(name, "officer") for name in ("eva", "max")]
        self.robot = self.chain.robot.identity.public_key

    def lost(self, name: str = "ben", records: int = 1) -> Visit:
        """A visit of somebody whose wallet nobody has any more."""
        visit = self.chain.open_visit(self.chain.enrol(name))
        for _ in range(records):
            self.chain.record(visit)
        return visit

    def pass_span(self) -> tuple[int, int]:
        """Let the bucket of now be over; return it."""
        from_ms = self.chain.bucket()
        self.chain.time_ms = from_ms + BUCKET_MS
        self.chain.block([])
        return from_ms, from_ms + BUCKET_MS

    async def agree(self, span: tuple[int, int], visits: int | None = None) -> str:
        first, second = map(LostKeys, self.officers)
        found = await first.preview(self.robot.hex()[:8], *span)
        proposal_id = (await first.propose(found.span, "key-lost", visits or len(found.touched))).hex()
        await second.approve(await second.find(proposal_id))
        return proposal_id


def quiet(_: int, __: int) -> None:
    """Nobody listens."""


@pytest.fixture
def house(tmp_path: Path) -> LostKeyHarness:
    return LostKeyHarness(tmp_path)


async def test_a_preview_counts_whom_it_would_touch_and_what_stays(house: LostKeyHarness) -> None:
    chain = house.chain
    lost, restricted, denied = house.lost(records=3), house.lost("cleo", 2), house.lost("dan")
    chain.must(restricted.key, "rights", "restrict", restricted.records[:1], "legal-claim")
    chain.must(denied.key, "rights", "wrong_person")
    span = house.pass_span()
    house.lost("eve")
    found = await LostKeys(house.officers[0]).preview(house.robot.hex()[:8], *span)
    assert found.span == make_span(house.robot, *span)
    assert [visit.owner for visit in found.visits] == [lost.owner, restricted.owner, denied.owner]
    assert ([len(visit.erasable) for visit in found.visits], found.records_count) == ([3, 1, 0], 4)
    assert [(visit.restricted_count, visit.denied) for visit in found.visits] == [(0, False), (1, False), (0, True)]
    asked = {key for flat, key in house.wire.asked if flat.startswith(b"records")}
    assert asked == {house.officers[0].keys.identity.public_key}, "as a member, with no visit's key"


async def test_only_announcements_near_the_span_are_read(house: LostKeyHarness) -> None:
    """A year's ledger is not walked over for five minutes of it; what a spool delivered late is found."""
    chain = house.chain
    for number in range(30):
        house.lost(f"early-{number}")
        chain.time_ms += DAY_MS // 4
    late, arguments = chain.visit_of(chain.enrol("late"))
    arguments[3] = late.bucket_ms
    span = house.pass_span()
    chain.time_ms += DAY_MS - 2 * BUCKET_MS
    chain.must(chain.robot.identity, "records", "open_visit", *arguments)
    chain.record(late, bucket_ms=late.bucket_ms)
    for number in range(30):
        chain.time_ms += DAY_MS // 4
        house.lost(f"later-{number}")
    house.wire.page_count, house.wire.pages = 4, 0
    found = await LostKeys(house.officers[0]).preview(house.robot.hex()[:8], *span)
    assert [visit.owner for visit in found.visits] == [late.owner]
    assert house.wire.pages < 15, "61 announcements in pages of four would be 16, and the halving takes six"


async def test_visits_that_were_transferred_since_hide_nothing_and_count_once(house: LostKeyHarness) -> None:
    """A transfer is announced late with the visit's old time: halving must not be led past the span by it."""
    chain, ben = house.chain, house.chain.enrol("ben")
    old = [chain.open_visit(ben, number) for number in range(4)]
    chain.time_ms += 3 * DAY_MS
    lost = house.lost("cleo")
    span = house.pass_span()
    chain.time_ms += 3 * DAY_MS
    for number, visit in enumerate(old):
        chain.transfer(visit, ben, 50 + number)
    chain.transfer(lost, ben, 60)
    found = await LostKeys(house.officers[0]).preview(house.robot.hex()[:8], *span)
    assert [(visit.owner, len(visit.erasable)) for visit in found.visits] == [(lost.owner, 1)]


async def test_two_officers_erase_and_whoever_is_hit_is_told(house: LostKeyHarness) -> None:
    mine = house.ward.open_visit()
    kept_id = house.ward.record(mine)
    lost = house.lost(records=70)
    span = house.pass_span()
    proposal_id = await house.agree(span)
    second = LostKeys(house.officers[1])
    told: list[tuple[int, int]] = []
    ordered = await second.erase(await second.find(proposal_id), lambda number, count: told.append((number, count)))
    assert (ordered.visits, ordered.records, len(ordered.erasure_ids), ordered.left_visits) == (2, 71, 3, 0)
    assert told == [(0, 2), (1, 2)]
    for erasure_id in ordered.erasure_ids:
        house.chain.receipts_of_all(erasure_id)
    gone = [house.chain.view("records", "get", record_id)["status"] for record_id in (kept_id, *lost.records)]
    assert set(gone) == {"erased"}
    again = await second.erase(await second.find(proposal_id), quiet)
    assert (again.visits, again.records) == (0, 0)
    (report,) = await house.patient.records()
    (one,) = report.rights.officers
    assert (one.reason, one.records, one.proposal_id.hex()) == ("key-lost", 1, proposal_id)


async def test_what_was_restricted_since_stays_and_the_rest_goes(
    house: LostKeyHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    lost, other = house.lost(), house.lost("cleo")
    proposal_id = await house.agree(house.pass_span())
    first = LostKeys(house.officers[0])
    before = await first.preview_span((await first.find(proposal_id)).span)
    house.chain.must(other.key, "rights", "restrict", [], "accuracy")

    async def as_before(_: Any) -> Any:
        return before

    monkeypatch.setattr(first, "preview_span", as_before)
    ordered = await first.erase(await first.find(proposal_id), quiet)
    assert (ordered.visits, ordered.records, ordered.kept_visits) == (1, 1, 1)
    statuses = [house.chain.view("records", "get", visit.records[0])["status"] for visit in (lost, other)]
    assert statuses == ["erasing", "active"]


async def test_more_visits_than_were_approved_stay_until_they_are_proposed(house: LostKeyHarness) -> None:
    visits = [house.lost(name) for name in ("ben", "cleo", "dan")]
    proposal_id = await house.agree(house.pass_span(), visits=2)
    first = LostKeys(house.officers[0])
    ordered = await first.erase(await first.find(proposal_id), quiet)
    assert (ordered.visits, ordered.left_visits) == (2, 1)
    house.chain.record(visits[0], bucket_ms=visits[0].bucket_ms)
    ordered = await first.erase(await first.find(proposal_id), quiet)
    assert (ordered.visits, ordered.left_visits) == (1, 1), "a visit that was counted may go on"


async def test_a_proposal_whose_time_is_over_says_so(house: LostKeyHarness) -> None:
    house.lost()
    proposal_id = await house.agree(house.pass_span())
    house.chain.time_ms += LOST_KEY_CARRY_OUT_MS + 1
    house.chain.block([])
    proposal = await LostKeys(house.officers[0]).find(proposal_id)
    assert (proposal.status, proposal.is_open) == ("lapsed", False)
    with pytest.raises(BlockRobotError, match="PROPOSAL_LAPSED"):
        await LostKeys(house.officers[0]).erase(proposal, quiet)


async def test_wrong_names_and_spans_are_refused_before_anything_is_asked(house: LostKeyHarness) -> None:
    house.lost()
    from_ms, until_ms = house.pass_span()
    handling, robot = LostKeys(house.officers[0]), house.robot.hex()
    for name, start, end, code in (
        (robot[:7], from_ms, until_ms, "NAME_TOO_SHORT"),
        ("00" * 33, from_ms, until_ms, "SPAN_EMPTY"),
        (robot, until_ms, from_ms, "SPAN_INVALID"),
        (robot, from_ms, from_ms + 61 * 60_000, "SPAN_INVALID"),
        (robot, until_ms + DAY_MS, until_ms + DAY_MS + 1, "SPAN_EMPTY"),
    ):
        with pytest.raises(BlockRobotError, match=rf"^{code}:"):
            await handling.preview(name, start, end)
    for start, code in (("b1", "NAME_TOO_SHORT"), ("cc" * 6, "PROPOSAL_NOT_FOUND")):
        with pytest.raises(BlockRobotError, match=rf"^{code}:"):
            await handling.find(start)


async def test_a_robot_needs_no_name_where_it_was_alone_and_is_named_where_it_was_not(house: LostKeyHarness) -> None:
    chain, handling = house.chain, LostKeys(house.officers[0])
    other = chain.enrol("robot-2", "robot")
    house.lost()
    first = house.pass_span()
    assert (await handling.preview("", *first)).span.robot == house.robot
    visits = [chain.open_visit(chain.enrol(name), 1, robot) for name, robot in (("cleo", chain.robot), ("dan", other))]
    second = house.pass_span()
    with pytest.raises(BlockRobotError) as refusal:
        await handling.preview("", *second)
    assert refusal.value.code == "NAME_AMBIGUOUS"
    assert all(visit.robot.identity.public_key.hex()[:10] in refusal.value.detail for visit in visits)


def test_a_span_is_widened_to_whole_buckets() -> None:
    span = make_span(b"r", BUCKET_MS + 1, 2 * BUCKET_MS + 1)
    assert (span.from_ms, span.until_ms) == (BUCKET_MS, 3 * BUCKET_MS)


@pytest.fixture
def run(house: LostKeyHarness, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Call a command as the first officer, the second, or the patient."""
    wallets = {"eva": house.officers[0], "max": house.officers[1], "ann": house.patient}
    who = [house.patient]

    open_for_commands(monkeypatch, lambda: who[0])

    def call(name: str, *arguments: str, typed: str | None = None) -> Result:
        who[0] = wallets[name]
        if name == "ann":
            return CliRunner().invoke(wallet_cli.wallet, list(arguments))
        words = ["--profile", name, "lost-keys", *arguments]
        return CliRunner().invoke(breach_commands.officer, words, input=typed)

    return call


def moment(time_ms: int) -> str:
    return lost_keys_commands.format_time(time_ms)


def test_questions_leave_the_json_alone(house: LostKeyHarness, run: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    sit_at_terminal(monkeypatch)
    house.lost()
    from_ms, until_ms = house.pass_span()
    span = ("--robot", house.robot.hex()[:10], "--from", moment(from_ms), "--until", moment(until_ms))
    proposed = run("eva", "propose", *span, "--reason", "key-lost", "--json", typed="y\n")
    name = json.loads(proposed.stdout)["proposal_id"][:12]
    assert "erased, all of it? [y/N]" in proposed.stderr
    for who, what in (("max", "approve"), ("eva", "erase")):
        assert json.loads(run(who, what, name, "--json", typed="y\n").stdout)["ok"]


@pytest.mark.parametrize("language", LANGUAGES)
def test_the_whole_way_as_officers_type_it(
    house: LostKeyHarness, run: Any, transcript: Transcript, monkeypatch: pytest.MonkeyPatch, language: str
) -> None:
    monkeypatch.setenv(LANGUAGE_VARIABLE, language)
    say = transcript.follow(run)
    house.ward.record(house.ward.open_visit())
    house.lost()
    from_ms, until_ms = house.pass_span()
    span = ("--robot", house.robot.hex()[:10], "--from", moment(from_ms), "--until", moment(until_ms))
    say("eva", "preview", *span)
    for more in ((), ("--visits", "1", "--yes"), ("--yes",)):
        say("eva", "propose", *span, "--reason", "key-lost", *more)
    (listed,) = json.loads(run("max", "list", "--json").stdout)["proposals"]
    name = listed["proposal_id"][:12]
    assert (listed["status"], listed["visits_max"], listed["approver"]) == ("proposed", 2, None)
    say("eva", "list")
    say("max", "list")
    say("eva", "approve", name, "--yes")
    agreed = json.loads(run("max", "approve", name, "--yes", "--json").stdout)
    assert (agreed["status"], agreed["preview"]["records"]) == ("approved", 2)
    say("max", "list")
    say("max", "erase", name, "--yes")
    say("eva", "erase", name, "--yes")
    say("ann", "records")
    say("ann", "audit")
    (visit,) = json.loads(run("ann", "records", "--json").stdout)["visits"]
    assert visit["erased_by_officers"][0]["reason"] == "key-lost"
    say("eva", "stop", name)
    assert json.loads(run("eva", "list", "--all", "--json").stdout)["proposals"][0]["status"] == "stopped"
    say("eva", "list")
    transcript.compare(f"lost-keys.{language}")


def test_what_is_gone_is_not_proposed_and_a_moment_is_one(house: LostKeyHarness, run: Any) -> None:
    visit = house.lost()
    house.chain.must(visit.key, "erasure", "request", visit.records, [])
    from_ms, until_ms = house.pass_span()
    span = ("--robot", house.robot.hex()[:10], "--from", moment(from_ms), "--until", moment(until_ms))
    assert "Nothing in that span is left to erase." in run("eva", "propose", *span, "--reason", "key-lost").stderr
    wrong = run("eva", "preview", *span[:3], "half past nine", *span[4:])
    assert (wrong.exit_code, "or a date and a time" in wrong.stderr) == (2, True)


@pytest.mark.parametrize("language", LANGUAGES)
def test_a_wallet_tells_how_a_breach_ended(
    house: LostKeyHarness, run: Any, transcript: Transcript, monkeypatch: pytest.MonkeyPatch, language: str
) -> None:
    monkeypatch.setenv(LANGUAGE_VARIABLE, language)

    eva = house.officers[0].keys.identity
    mine = house.ward.open_visit()
    house.ward.record(mine)

    def deny() -> bytes:
        key = asyncio.run(house.ward.owner_key(mine.owner))
        breach_id = house.chain.must(key, "rights", "wrong_person").txid
        house.chain.must(eva, "rights", "assess", breach_id, "none", "owner-confirmed")
        return breach_id

    say = transcript.follow(run)
    house.chain.must(eva, "rights", "close", deny(), "released", "owner-confirmed")
    say("ann", "records")
    breach_id = deny()
    say("ann", "records")
    records = house.chain.view("records", "of_visit", mine.owner)
    house.chain.must(eva, "rights", "order_erasure", breach_id, records)
    house.chain.must(eva, "rights", "close", breach_id, "erased", "matched-wrongly")
    say("ann", "records")
    transcript.compare(f"denied-visits.{language}")
    (visit,) = json.loads(run("ann", "records", "--json").stdout)["visits"]
    assert (visit["breach_end"]["outcome"], visit["breach_end"]["breach_id"]) == ("erased", breach_id.hex())

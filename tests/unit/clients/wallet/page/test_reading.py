"""What the page shows: days, records, what happened; all of it from what the wallet has proven."""

from __future__ import annotations

import asyncio
import dataclasses
import time
from collections.abc import Sequence
from typing import Any

import msgspec
import pytest

from clients.wallet.page import wallet_snapshot as snapshots
from clients.wallet.records.erasure import ErasureClient
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from consensus.records.metadata import NOTICE_SENSOR
from consensus.state.records import RECORD
from tests.unit.clients.wallet.page.conftest import PageHarness


async def test_a_recording_that_comes_in_is_news_and_shows(desk: PageHarness) -> None:
    before = await desk.page.get("/api/overview")
    assert (before["state"], before["counts"]["records"]) == ("ready", 0)
    assert (await desk.page.get("/api/days"))["days"] == []
    _, ids = desk.ward.record_visit()
    await desk.read()
    changes = await desk.page.get("/api/changes", after=before["news"], wait_ms=1_000)
    assert changes["news"] == before["news"] + 1
    assert set(changes["new_records"]) == {record_id.hex() for record_id in ids}
    (day,) = (await desk.page.get("/api/days", zone="Europe/Lisbon"))["days"]
    assert (day["records"], day["pictures"], day["unsure"]) == (2, 4, 2)
    found = await desk.page.get("/api/records", day=day["day"], zone="Europe/Lisbon")
    assert [row["record_id"] for row in found["records"]] == [record_id.hex() for record_id in ids]
    assert found["records"][0]["kind"] == "depth"


async def test_who_asks_for_news_waits_until_there_are_some(desk: PageHarness, monkeypatch: pytest.MonkeyPatch) -> None:
    before, asked, wait_news = desk.session.news, asyncio.Event(), desk.session.wait_news
    answer = await desk.page.get("/api/changes", after=before, wait_ms=1)
    assert (answer["news"], answer["new_records"]) == (before, [])

    async def note(after: int, wait_ms: int) -> list[bytes]:
        asked.set()
        return await wait_news(after, wait_ms)

    monkeypatch.setattr(desk.session, "wait_news", note)
    waiting = asyncio.create_task(desk.page.get("/api/changes", after=before, wait_ms=25_000))
    await asked.wait()
    _, ids = desk.ward.record_visit()
    await desk.read()
    answer = await waiting
    assert (answer["news"], len(answer["new_records"])) == (before + 1, len(ids))


async def test_nothing_is_read_again_of_a_visit_in_which_nothing_happened(
    desk: PageHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    desk.ward.record_visit()
    await desk.read()

    async def never(*_: object) -> None:
        raise AssertionError("the visit was read again")

    monkeypatch.setattr(desk.session.wallet, "visit_report", never)
    monkeypatch.setattr(snapshots, "audit_visit", never)
    await desk.read()
    assert desk.session.state == "ready"


async def test_of_a_visit_that_goes_on_only_the_record_that_came_in_is_read(
    desk: PageHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    visit = desk.ward.open_visit()
    ids = [desk.ward.record(visit) for _ in range(5)]
    await desk.read()
    asked: list[bytes] = []
    wallet = desk.session.wallet
    read = wallet.values

    async def note(keys: Sequence[bytes], session: PrivateKey) -> dict[bytes, Any]:
        asked.extend(keys)
        return await read(keys, session)

    monkeypatch.setattr(wallet, "values", note)
    ids.append(desk.ward.record(visit))
    await desk.read()
    records = [RECORD.split(key)[0] for key in asked if RECORD.owns(key)]
    assert records == ids[-1:]
    assert list(desk.session.snapshot.entries) == ids


async def test_of_a_visit_in_which_something_was_erased_every_record_is_read_again(desk: PageHarness) -> None:
    visit = desk.ward.open_visit()
    ids = [desk.ward.record(visit) for _ in range(2)]
    await desk.read()
    await ErasureClient(desk.session.wallet).request_each([desk.session.snapshot.entry(ids[0])], [])
    ids.append(desk.ward.record(visit))
    await desk.read()
    statuses = [desk.session.snapshot.entry(record_id).state.status for record_id in ids]
    assert statuses == ["erasing", "active", "active"]


async def test_records_are_filtered_and_paged(desk: PageHarness) -> None:
    desk.ward.record_visit(5)
    await desk.read()
    first = await desk.page.get("/api/records", limit=2)
    assert (first["total"], first["next"], len(first["records"])) == (5, "2", 2)
    last = await desk.page.get("/api/records", limit=2, cursor=4)
    assert (last["next"], len(last["records"])) == (None, 1)
    robot = first["records"][0]["robot"]
    assert (await desk.page.get("/api/records", robot=robot, sensor="depth"))["total"] == 5
    assert (await desk.page.get("/api/records", sensor="rgb"))["total"] == 0
    assert (await desk.page.get("/api/records", day="1999-12-31"))["total"] == 0
    assert (await desk.page.get("/api/records", from_minute=0, until_minute=1440))["total"] == 5
    assert await desk.page.refused("GET", "/api/records?zone=Nowhere/../etc") == "REQUEST_INVALID"
    assert (await desk.page.get("/api/records", zone="Etc/Unknown"))["total"] == 5, "as this machine has it"
    assert await desk.page.refused("GET", "/api/records?limit=2001") == "REQUEST_INVALID"
    assert await desk.page.refused("GET", "/api/records?colour=red") == "REQUEST_INVALID"


async def test_one_record_is_told_with_its_neighbours_and_its_story(desk: PageHarness) -> None:
    _, ids = desk.ward.record_visit(3)
    await desk.read()
    record = await desk.page.get(f"/api/records/{ids[1].hex()}")
    assert (record["previous"], record["next"]) == (ids[0].hex(), ids[2].hex())
    assert [event["kind"] for event in record["events"]] == ["recorded"]
    assert record["events"][0]["who"] == "robot"
    assert await desk.page.refused("GET", f"/api/records/{bytes(16).hex()}") == "NOT_FOUND"
    assert await desk.page.refused("GET", "/api/records/zz") == "REQUEST_INVALID"
    story = await desk.page.get("/api/audit-events", limit=2)
    assert (story["total"], story["next"], len(story["events"])) == (5, "2", 2)
    assert story["events"][0]["kind"] == "visit_closed"
    assert "3" in story["events"][0]["sentence"]


async def test_a_node_that_lies_is_named_and_what_was_known_stays(
    desk: PageHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    desk.ward.record_visit()
    await desk.read()
    error = BlockRobotError("PROOF_INVALID", "The answer is for other keys than were asked for.")
    desk.ward.network.troubles["custodian-1"] = error

    async def fail() -> None:
        raise error

    monkeypatch.setattr(desk.session.wallet, "scan", fail)
    await desk.read()
    told = await desk.page.get("/api/overview")
    assert (told["state"], told["problem"]["code"], told["counts"]["records"]) == ("failed", "PROOF_INVALID", 2)
    assert [(node["name"], node["state"]) for node in told["network"]["nodes"]] == [
        ("custodian-1", "lied"),
        ("custodian-2", "fine"),
    ]


async def test_that_a_node_was_away_is_forgotten_after_a_while_that_it_lied_is_not(desk: PageHarness) -> None:
    for code, states in (("NODE_UNREACHABLE", ["unreachable", "fine"]), ("CERTIFICATE_INVALID", ["lied", "lied"])):
        desk.ward.network.troubles["custodian-1"] = BlockRobotError(code)
        for state in states:
            node, _ = (await desk.page.get("/api/overview"))["network"]["nodes"]
            assert node["state"] == state
            desk.ward.chain.time_ms += 6 * 60_000


async def test_it_speaks_the_language_that_the_page_asks_for(desk: PageHarness) -> None:
    english, portuguese = [(await desk.page.get("/api/texts", language=each))["texts"] for each in ("en", "pt")]
    assert english.keys() == portuguese.keys()
    assert english["nav.story"] != portuguese["nav.story"]
    desk.page.headers["Accept-Language"] = "pt"
    status, problem = await desk.page.ask("GET", f"/api/records/{bytes(16).hex()}")
    assert (status, problem["code"]) == (404, "NOT_FOUND")
    assert await desk.page.refused("GET", "/api/texts?language=tlh") == "REQUEST_INVALID"


async def test_a_note_of_what_was_not_kept_is_no_recording(desk: PageHarness) -> None:
    desk.ward.record_visit(3)
    await desk.read()
    (part,) = desk.session.snapshot.visits
    notes = [
        dataclasses.replace(entry, metadata=msgspec.structs.replace(entry.metadata, sensor=NOTICE_SENSOR))
        for entry in part.report.records[1:]
    ]
    with_notes = (part.report.records[0], *notes)
    object.__setattr__(part.report, "records", with_notes)
    desk.session.snapshot.entries.update({entry.record_id: entry for entry in notes})
    calendar = await desk.page.get("/api/days", zone="Europe/Lisbon")
    assert (calendar["days"][0]["records"], calendar["days"][0]["notices"]) == (1, 2)
    assert calendar["sensors"] == ["depth"]
    counts = (await desk.page.get("/api/overview"))["counts"]
    assert (counts["records"], counts["notices"], counts["kinds"]) == (1, 2, {"depth": 2})
    plan = await desk.page.post("/api/erasures/plan", {"records": [entry.record_id.hex() for entry in notes]})
    assert plan["kinds"] == {}


async def test_what_she_has_is_counted_without_the_pictures_that_are_erased(desk: PageHarness) -> None:
    visit, ids = desk.ward.record_visit(3)
    await desk.ward.erase(visit, [ids[0]], [1])
    await desk.read()
    assert (await desk.page.get("/api/overview"))["counts"]["kinds"] == {"depth": 5}
    plan = await desk.page.post("/api/erasures/plan", {"records": [record_id.hex() for record_id in ids]})
    assert plan["kinds"] == {"depth": 5}


async def test_a_day_of_two_thousand_records_is_listed_within_a_second(desk: PageHarness) -> None:
    desk.ward.record_visit(3)
    await desk.read()
    many = desk.session.snapshot.visits[0]
    entries = many.report.records * 700
    object.__setattr__(many.report, "records", entries)
    started = time.process_time()
    await desk.page.get("/api/days", zone="Europe/Lisbon")
    found = await desk.page.get("/api/records", limit=2_000, zone="Europe/Lisbon")
    assert (found["total"], len(found["records"])) == (2_100, 2_000)
    assert time.process_time() - started < 1.0

"""One look at a meeting is one entry of its audit trail, and nothing that the page does by itself is any."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from clients.wallet.commands.view_commands import _view_all
from clients.wallet.ledger.visit_audit import audit_visit
from clients.wallet.page.routes import clip_routes
from clients.wallet.records.viewing import RecordViewer
from consensus.errors import BlockRobotError
from consensus.records.clips import ClipDownload
from tests.unit.clients.wallet.page.conftest import PageHarness
from tests.world.sharing import SharedWard


async def trail_of(ward: SharedWard) -> list[tuple[str, dict[str, Any]]]:
    """What was asked for and found of the only visit, in order."""
    (visit,) = await ward.wallet.scan()
    entries = await audit_visit(ward.wallet, visit)
    return [(entry.kind, entry.data) for entry in entries if entry.kind in {"access_requested", "verdict"}]


async def test_all_parts_of_a_meeting_are_one_look_and_what_was_found_one_finding(
    desk: PageHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    """70 recordings are more than one request may name, and 30 are a part."""
    monkeypatch.setattr(clip_routes, "RECORDS_MAX_COUNT", 30)
    _, ids = desk.ward.record_visit(70)
    await desk.read()
    names = [record_id.hex() for record_id in ids]
    for start in (0, 30, 60, 0):
        asked = {"records": names[start : start + 30], "look": "one", "meeting": True}
        opened = await desk.page.do("/api/clips", asked)
    ((kind, data),) = await trail_of(desk.ward)
    assert (kind, data["records"]) == ("access_requested", 0), "the whole visit, by one request"
    await desk.page.do(f"/api/clips/{opened['clip']}/verdict")
    _, (kind, data) = await trail_of(desk.ward)
    assert (kind, data["verdict"], len(data["findings"])) == ("verdict", "verified", 30)
    rows = (await desk.page.get("/api/records", limit=100))["records"]
    assert [row["verdict"] for row in rows].count("verified") == 30
    await desk.page.do("/api/clips", {"records": names[:1], "look": "another", "meeting": True})
    assert [kind for kind, _ in await trail_of(desk.ward)] == ["access_requested", "verdict", "access_requested"]


async def test_a_look_that_failed_is_gone_on_with_and_not_asked_for_again(desk: PageHarness) -> None:
    _, ids = desk.ward.record_visit(2)
    await desk.read()
    asked = {"records": [record_id.hex() for record_id in ids], "look": "one", "meeting": True}
    desk.ward.custody.refusals[ids[0]] = "CLIP_ERASED"
    job = await desk.page.follow(await desk.page.post("/api/clips", asked))
    assert job["state"] == "failed"
    desk.ward.custody.refusals.clear()
    assert (await desk.page.do("/api/clips", asked))["records"] == 2
    assert len(await trail_of(desk.ward)) == 1


async def test_a_recording_that_came_in_later_is_asked_for_by_itself(desk: PageHarness) -> None:
    visit = desk.ward.open_visit()
    first = desk.ward.record(visit)
    await desk.read()
    await desk.page.do("/api/clips", {"records": [first.hex()], "look": "one", "meeting": True})
    second = desk.ward.record(visit)
    await desk.read()
    await desk.page.do("/api/clips", {"records": [first.hex(), second.hex()], "look": "one", "meeting": True})
    assert [data["records"] for _, data in await trail_of(desk.ward)] == [1, 1]


async def test_of_a_finding_on_a_meeting_each_recordings_page_tells_its_own(desk: PageHarness) -> None:
    _, ids = desk.ward.record_visit(2)
    await desk.read()
    desk.ward.spoil(ids[0], 1)
    names = [record_id.hex() for record_id in ids]
    opened = await desk.page.do("/api/clips", {"records": names})
    await desk.page.do(f"/api/clips/{opened['clip']}/verdict")
    told = [(await desk.page.get(f"/api/records/{name}"))["events"][0] for name in names]
    assert [(event["tone"], event["sentence"]) for event in told] == [
        ("bad", "You checked it: it is not as the robot took it."),
        ("good", "You checked it: it is as the robot took it."),
    ]
    story = (await desk.page.get("/api/audit-events"))["events"][0]
    assert story["sentence"] == "You checked 2 recordings. Not as the robot took them: 1."


async def test_nothing_that_is_read_is_signed_in_whatever_language(desk: PageHarness) -> None:
    """All that the page asks by itself: every GET of it, and the reading of the chain."""
    visit, ids = desk.ward.record_visit(2)
    await desk.read()
    opened = await desk.page.do("/api/clips", {"records": [record_id.hex() for record_id in ids]})
    before = desk.ward.chain.head.height
    resources = [route.resource for route in desk.served.app.router.routes() if route.method == "GET"]
    gets = [resource.canonical for resource in resources if resource and resource.canonical.startswith("/api/")]
    assert len(gets) > 15
    values = {"{clip}": opened["clip"], "{number}": "0", "{record}": ids[0].hex(), "{job}": "none"}
    for language in ("en", "pt"):
        desk.page.headers["Accept-Language"] = language
        for path in gets:
            where = path
            for name, value in values.items():
                where = where.replace(name, value)
            await desk.page.ask("GET", where, params={"visit": visit.owner.hex()} if path.endswith("/story") else None)
        await desk.read()
    assert desk.ward.chain.head.height == before


async def test_the_command_writes_one_request_and_one_finding_for_a_meeting(ward: SharedWard) -> None:
    ward.record_visit(3)
    viewing = RecordViewer(ward.wallet)
    views = [view async for view in viewing.view_each(await ward.entries(), "own-access", verdict=True)]
    assert len(views) == 3
    assert [kind for kind, _ in await trail_of(ward)] == ["access_requested", "verdict"]


async def test_what_was_found_before_a_record_could_not_be_had_is_written_down(ward: SharedWard) -> None:
    _, ids = ward.record_visit(3)
    ward.custody.refusals[ids[2]] = "CLIP_ERASED"
    with pytest.raises(BlockRobotError):
        [view async for view in RecordViewer(ward.wallet).view_each(await ward.entries(), "own-access", verdict=True)]
    (_, data) = (await trail_of(ward))[-1]
    assert [finding[0] for finding in data["findings"]] == ids[:2]


@pytest.mark.parametrize("place", ["while a record is fetched", "between two records"])
async def test_what_was_found_before_she_stopped_is_written_down(
    ward: SharedWard, place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C cancels the command after its second record, wherever it waits then."""
    _, ids = ward.record_visit(3)
    entries, told, download = await ward.entries(), list[str](), ward.custody.download_clip

    def on_progress(line: str) -> None:
        told.append(line)
        if len(told) == 3 and place == "between two records":
            raise asyncio.CancelledError

    async def download_until_stopped(*rest: Any) -> ClipDownload:
        if len(told) == 3:
            looking.cancel()
            await asyncio.sleep(0)
        return await download(*rest)

    monkeypatch.setattr(ward.custody, "download_clip", download_until_stopped)
    looking = asyncio.create_task(_view_all(ward.wallet, entries, "own-access", verdict=True, on_progress=on_progress))
    with pytest.raises(asyncio.CancelledError):
        await looking
    kind, data = (await trail_of(ward))[-1]
    assert (kind, [finding[0] for finding in data["findings"]]) == ("verdict", ids[:2])

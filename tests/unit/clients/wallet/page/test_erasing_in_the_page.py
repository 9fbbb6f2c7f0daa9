"""Erasing in the page: it tells what goes, who confirms, and asks for no picture twice."""

from __future__ import annotations

import pytest

from clients.wallet.page.routes import erasure_routes
from tests.unit.clients.wallet.page.conftest import PASSPHRASE, PageHarness
from tests.unit.clients.wallet.page.test_doing import recorded


async def test_erasing_tells_what_goes_and_what_stays_and_shows_receipts_as_they_come(
    desk: PageHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(erasure_routes, "WAIT_MAX_S", 0.0)
    ids = await recorded(desk)
    plan = await desk.page.post("/api/erasures/plan", {"all": True})
    assert (plan["records"], plan["kinds"], plan["visits"]) == (ids, {"depth": 4}, 1)
    one = {"records": ids[:1], "frames": [1]}
    assert (await desk.page.post("/api/erasures/plan", one))["kinds"] == {"depth": 1}
    assert await desk.page.refused("POST", "/api/erasures/plan", one | {"frames": [2]}) == "REQUEST_INVALID"
    for none in ([], None, ""):
        asked = one | {"frames": none, "passphrase": PASSPHRASE}
        assert await desk.page.refused("POST", "/api/erasures", asked) == "REQUEST_INVALID", "not the whole record"
    assert await desk.page.refused("POST", "/api/erasures/plan", {"records": ids, "frames": [0]}) == "REQUEST_INVALID"
    assert await desk.page.refused("POST", "/api/erasures", {"records": ids}) == "REQUEST_INVALID"
    job = await desk.page.follow(await desk.page.post("/api/erasures", {"records": ids, "passphrase": PASSPHRASE}))
    assert (job["state"], job["result"]["complete"]) == ("done", False)
    assert [row["confirmed_at_ms"] for row in job["receipts"]] == [None, None]
    (erasure,) = (await desk.page.get("/api/erasures"))["erasures"]
    assert (erasure["status"], erasure["records"]) == ("requested", 2)
    assert await desk.page.refused("POST", "/api/erasures/plan", {"all": True}) == "NOT_FOUND"
    desk.ward.chain.time_ms += 200_000
    (late,) = (await desk.page.get("/api/inbox"))["overdue"]
    assert all(row["overdue"] for row in late["custodians"])


async def test_of_what_is_erased_no_picture_stays_open(desk: PageHarness, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(erasure_routes, "WAIT_MAX_S", 0.0)
    ids = await recorded(desk)
    looks = [await desk.page.do("/api/clips", {"records": ids[:1]}) for _ in range(2)]
    await desk.page.do(f"/api/clips/{looks[0]['clip']}/verdict")
    other = await desk.page.do("/api/clips", {"records": ids[1:]})
    await desk.page.do("/api/erasures", {"records": ids[:1], "frames": [0], "passphrase": PASSPHRASE})
    for look in looks:
        assert await desk.page.refused("GET", f"/api/clips/{look['clip']}/frames/0/file") == "CLIP_NOT_OPEN"
    await desk.page.get(f"/api/clips/{other['clip']}/frames/0/file")


async def test_a_picture_whose_erasure_is_asked_for_already_is_left_out_on_the_page_too(
    desk: PageHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(erasure_routes, "WAIT_MAX_S", 0.0)
    ids = await recorded(desk)
    first = {"records": ids[:1], "frames": [0]}
    await desk.page.do("/api/erasures", first | {"passphrase": PASSPHRASE})
    await desk.read()
    assert await desk.page.refused("POST", "/api/erasures/plan", first) == "NOT_FOUND"
    assert await desk.page.refused("POST", "/api/erasures", first | {"passphrase": PASSPHRASE}) == "NOT_FOUND"
    plan = await desk.page.post("/api/erasures/plan", first | {"frames": [0, 1]})
    assert (plan["frames"], plan["kinds"]) == ([1], {"depth": 1})
    await desk.page.do("/api/erasures", first | {"frames": [0, 1], "passphrase": PASSPHRASE})
    asked = [row["frames"] for row in (await desk.page.get("/api/erasures"))["erasures"]]
    assert sorted(asked) == [[0], [1]]

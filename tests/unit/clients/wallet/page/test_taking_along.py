"""Taking along on the page: the file is for the page alone, goes when it is told to, and with the program in any case."""

from __future__ import annotations

import asyncio
import threading
from pathlib import Path
from typing import Any

import pytest

from clients.wallet.page.routes import export_routes
from tests.unit.clients.wallet.page.conftest import PASSPHRASE, PageHarness
from tests.world.dicts import typed_for

WISH = {"now": True, "identity": False, "passphrase": PASSPHRASE}
WAIT_S = 10.0
FAR_BEYOND_BUFFERS_BYTES = 64 * 1024 * 1024
"""More than a connection of this machine holds on its way."""


def left_in(folder: Path) -> list[str]:
    return [path.name for path in folder.iterdir() if not path.name.startswith("open-")]


async def test_the_file_can_be_fetched_has_no_name_on_the_disk_and_goes_when_it_is_forgotten(desk: PageHarness) -> None:
    desk.ward.record_visit()
    await desk.read()
    done = await desk.page.do("/api/exports", WISH)
    assert left_in(desk.session.folder) == [], "a program that is killed leaves no pictures behind"
    path = f"/api/exports/{done['export']}/file"
    content = await desk.page.get(path)
    assert (content[:2], len(content)) == (b"PK", done["bytes"])
    assert await desk.page.get(path) == content, "it can be fetched twice"
    await desk.page.ask("DELETE", f"/api/exports/{done['export']}")
    assert await desk.page.refused("GET", path) == "NOT_FOUND"


async def test_a_file_counts_as_fetched_once_all_of_it_was_sent_and_not_when_it_begins(desk: PageHarness) -> None:
    path = desk.session.folder / "long.zip"
    with path.open("wb") as file:
        file.truncate(FAR_BEYOND_BUFFERS_BYTES)
    desk.session.keep_export("long", path)
    kept, page = desk.session.exports["long"], desk.page
    asked = page.http.get(f"{page.origin}/api/exports/long/file", headers=page.headers)
    async with asked as answer:
        assert answer.status == 200
        assert len(await answer.content.readexactly(1)) == 1
        assert not kept.was_fetched, "most of it is on this side"
        assert len(await answer.read()) == FAR_BEYOND_BUFFERS_BYTES - 1
    await page.get("/api/overview")
    assert kept.was_fetched


async def test_it_says_how_anybody_checks_the_file_against_the_network_that_this_wallet_trusts(
    desk: PageHarness, tmp_path: Path
) -> None:
    desk.ward.record_visit()
    await desk.read()
    with typed_for("ann", genesis=tmp_path / "our network.json"):
        done = await desk.page.do("/api/exports", WISH)
    assert done["check"] == f"blockrobot verify {done['name']} --genesis '{tmp_path / 'our network.json'}'"


async def test_where_no_file_is_without_a_name_it_is_deleted_when_the_page_forgets_it(
    desk: PageHarness, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("clients.wallet.page.session._DESCRIPTORS", desk.session.folder / "none")
    for name in ("one", "two"):
        path = desk.session.folder / f"{name}.zip"
        path.write_bytes(b"pictures")
        desk.session.keep_export(name, path)
    desk.session.forget_export("one")
    assert left_in(desk.session.folder) == ["two.zip"]
    desk.session._clear_folder()
    assert left_in(desk.session.folder) == []
    assert desk.session.exports == {}


@pytest.mark.parametrize("is_ready", [False, True])
async def test_of_an_export_that_is_stopped_while_it_is_written_nothing_stays(
    desk: PageHarness, monkeypatch: pytest.MonkeyPatch, is_ready: bool
) -> None:
    desk.ward.record_visit()
    await desk.read()
    begun, stopped, ended = threading.Event(), threading.Event(), threading.Event()

    def write(path: Path, _contents: Any, *, heard: Any) -> object:
        begun.set()
        try:
            assert stopped.wait(WAIT_S)
            if not is_ready:
                while True:
                    heard("checking", 1, 2)
            path.write_bytes(b"pictures")
            return object()
        finally:
            ended.set()

    monkeypatch.setattr(export_routes, "write_bundle", write)
    accepted = await desk.page.post("/api/exports", WISH)
    assert await asyncio.to_thread(begun.wait, WAIT_S)
    await desk.page.post(f"/api/jobs/{accepted['job']}/cancel")
    stopped.set()
    assert (await desk.page.follow(accepted))["state"] == "cancelled"
    assert ended.is_set(), "nothing goes on writing"
    assert (left_in(desk.session.folder), desk.session.exports) == ([], {})

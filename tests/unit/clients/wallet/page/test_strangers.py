"""A wallet that is no member's: new, or of somebody who left. The page says so, and shows what there is."""

from __future__ import annotations

from pathlib import Path

from clients.wallet.page.page import make_page
from clients.wallet.page.session import PageSession
from consensus.errors import BlockRobotError
from tests.unit.clients.wallet.page.conftest import PageHarness
from tests.wallet_page_client import WalletPage
from tests.world.sharing import SharedWard


async def test_a_new_wallet_is_told_that_it_is_not_registered(tmp_path: Path) -> None:
    ward = SharedWard(tmp_path)
    async with PageSession(ward.open_wallet("new"), "new", tmp_path / ".new.page", read_every_s=3_600.0) as session:
        served = make_page(session)
        async with WalletPage((await served.start()).redirect_file) as page:
            overview = await page.settle(lambda told: told["state"] != "reading")
            assert (overview["state"], overview["person"]["registered"]) == ("not_registered", False)
            assert overview["problem"]["code"] == "NOT_REGISTERED"
            assert overview["verified"]["height"] >= 0
            assert (await page.get("/api/days"))["days"] == []
            assert await page.refused("GET", "/api/consents") == "NOT_REGISTERED"
            assert await page.refused("GET", "/api/inbox") == "NOT_REGISTERED"
        await served.stop()


async def test_what_a_page_left_behind_when_it_was_killed_is_deleted_at_the_next_start(
    ward: SharedWard, tmp_path: Path
) -> None:
    folder = tmp_path / ".ann.page"
    folder.mkdir()
    names = ["export-0.zip", ".export-0.zip.0123abcd", "open-0.html"]
    for name in (*names, "letter.txt"):
        (folder / name).write_bytes(b"pictures")
    async with PageSession(ward.wallet, "ann", folder, read_every_s=3_600.0):
        assert [path.name for path in folder.iterdir()] == ["letter.txt"], "a session deletes what sessions write"
    assert (folder / "letter.txt").exists()
    assert folder.stat().st_mode & 0o777 == 0o700


async def test_what_is_nobodys_business_is_refused_whatever_it_is_called(desk: PageHarness) -> None:
    assert await desk.page.refused("GET", "/api/nothing") == "ROUTE_UNKNOWN"
    assert await desk.page.refused("DELETE", "/api/overview") == "METHOD_NOT_ALLOWED"
    for body in ([], {"records": "all"}, {"records": [1]}, {"records": ["zz"]}, {"records": [], "more": 1}):
        assert await desk.page.refused("POST", "/api/clips", body) == "REQUEST_INVALID"
    for name in ("../ann.wallet", "export-0.zip", "%2e%2e%2fann.wallet"):
        assert await desk.page.refused("GET", f"/api/exports/{name}/file") in {"NOT_FOUND", "ROUTE_UNKNOWN"}


async def test_a_node_that_has_not_followed_a_registration_is_no_liar_and_forgotten_once_she_is_registered(
    desk: PageHarness,
) -> None:
    refusals = desk.session.wallet.network.troubles
    refusals["custodian-1"] = BlockRobotError("SESSION_REFUSED")
    node, _ = (await desk.page.get("/api/overview"))["network"]["nodes"]
    assert (node["state"], node["sentence"]) == ("behind", None)
    desk.session.state = "not_registered"
    await desk.read()
    node, _ = (await desk.page.get("/api/overview"))["network"]["nodes"]
    assert node["state"] == "fine"


async def test_that_a_node_began_to_lie_or_to_be_away_is_news_once_and_so_is_that_it_is_back(desk: PageHarness) -> None:
    troubles = desk.session.wallet.network.troubles
    for code in ("PROOF_INVALID", "NODE_UNREACHABLE", None):
        heard = (await desk.page.get("/api/overview"))["news"]
        troubles.clear()
        troubles.update({} if code is None else {"custodian-1": BlockRobotError(code)})
        await desk.read()
        assert (await desk.page.get("/api/changes", after=heard))["news"] == heard + 1, code
        await desk.read()
        assert (await desk.page.get("/api/changes", after=heard))["news"] == heard + 1, code

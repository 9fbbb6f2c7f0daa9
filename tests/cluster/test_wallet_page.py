"""The wallet's page over a real network, by HTTP alone: opened, listed, played, verified, shared, erased, taken along.

The command runs as a process of its own, as it does for a person; the page is asked as a browser asks it.
"""

from __future__ import annotations

import asyncio
import io
import json
import os
import sys
import time
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from clients.bundle.checks.bundle_check import verify_bundle
from clients.wallet.consent.consent_choices import ConsentClient
from tests.cluster.network_under_test import NetworkUnderTest
from tests.cluster.test_rights import Ward
from tests.walking_alone import UID
from tests.wallet_page_client import WalletPage

PASSPHRASE = "tea"
DAY_MS = 24 * 3600 * 1000


class Served:
    """`blockrobot wallet serve` as a process."""

    def __init__(self, wallet_folder: Path, profile: str, genesis: Path, home: Path) -> None:
        self._arguments = ["--wallet-dir", str(wallet_folder), "--profile", profile, "--genesis", str(genesis)]
        secret = home / "passphrase"
        secret.write_text(PASSPHRASE, encoding="utf-8")
        self._environment = os.environ | {"BLOCKROBOT_PASSPHRASE_FILE": str(secret), "BLOCKROBOT_HOME": str(home)}

    async def run(self, *command: str) -> asyncio.subprocess.Process:
        return await asyncio.create_subprocess_exec(
            sys.executable, "-m", "network.cli.main", "wallet", *self._arguments, *command,
            env=self._environment, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE,
        )  # fmt: skip

    async def start(self) -> Path:
        self.process = await self.run("serve", "--no-browser", "--json")
        assert self.process.stdout is not None
        told = b""
        while not told.rstrip().endswith(b"}"):
            line = await self.process.stdout.readline()
            assert line, (await self.process.communicate())[1]
            told += line
        return Path(json.loads(told)["redirect_file"])


async def test_a_person_does_everything_in_the_page_that_she_does_in_the_terminal(
    network: NetworkUnderTest, tmp_path: Path
) -> None:
    ward = Ward(network, tmp_path)
    async with ward.wallet("ann") as ann, ward.wallet("doctor") as doctor:
        await ann.register(ward.desk.issue(UID, "subject"), [])
        await doctor.register(ward.desk.issue("D0C", "staff"), [])
        await ConsentClient(ann).give(["demo"], ["depth"])
        handle = doctor.store.content.handle.hex()
    await ward.prepare_robot()
    served = Served(tmp_path, "ann", network.folder / "genesis.json", tmp_path)
    file = await served.start()
    assert file.stat().st_mode & 0o777 == 0o600
    async with WalletPage(file) as page:
        assert not file.exists(), "what opens the page works once"
        overview = await page.settle(lambda told: told["state"] == "ready")
        assert (overview["counts"]["records"], overview["person"]["role"]) == (0, "subject")
        assert (await ward.record()).kept > 0
        await page.settle(lambda told: told["counts"]["records"] > 2)
        second = await served.run("records")
        listed, told = await second.communicate()
        assert (second.returncode, b"read beside it" in told, b"depth" in listed) == (0, True, True), told
        third = await served.run("notice")
        assert b"WALLET_BUSY" in (await third.communicate())[1]
        assert third.returncode == 1

        rows = await _list(page)
        await _play_and_verify(page, rows)
        await _consent(page)
        await _share_and_revoke(page, rows, handle)
        await _export(page, tmp_path, ward)
        await _erase(page, rows)
        await _lose_a_node(page, network)
        await page.post("/api/end")
    out, err = await served.process.communicate()
    assert (served.process.returncode, err) == (0, b"")
    assert not list((tmp_path / ".ann.page").iterdir()), "nothing is left behind"
    assert PASSPHRASE not in out.decode()


async def _list(page: WalletPage) -> list[dict[str, Any]]:
    days = await page.get("/api/days", zone="Europe/Lisbon")
    (day,) = days["days"]
    found = await page.get("/api/records", day=day["day"], zone="Europe/Lisbon")
    rows: list[dict[str, Any]] = found["records"]
    assert day["records"] == found["total"] == len(rows) > 2
    assert [row["started_at_ms"] for row in rows] == sorted(row["started_at_ms"] for row in rows)
    record = await page.get(f"/api/records/{rows[0]['record_id']}")
    assert record["commitment_root"]
    assert record["events"][0]["kind"] == "recorded"
    return rows


async def _play_and_verify(page: WalletPage, rows: list[dict[str, Any]]) -> None:
    pictures = [row["record_id"] for row in rows if row["frames"]]
    opened = await page.do("/api/clips", {"records": pictures})
    assert {seal["state"] for seal in opened["seals"]} == {"good"}
    clip = await page.get(f"/api/clips/{opened['clip']}")
    shown = [frame for frame in clip["frames"] if frame["status"] == "ok"]
    assert shown
    assert shown[0]["kind"] == "depth"
    path = f"/api/clips/{opened['clip']}/frames/{shown[0]['number']}"
    size = shown[0]["width"] * shown[0]["height"]
    whole = np.frombuffer(await page.get(f"{path}/depth"), dtype="<u2")
    own = np.frombuffer(await page.get(f"{path}/depth", own=1), dtype="<u2")
    assert whole.size == own.size == size
    assert 0 < np.count_nonzero(own) < np.count_nonzero(whole)
    assert np.array_equal(whole[own > 0], own[own > 0])
    assert (await page.get(f"{path}/file")).startswith(b"\x89PNG")
    assert await page.refused("GET", f"/api/clips/{opened['clip']}/frames/99999/depth") == "NOT_FOUND"
    await page.ask("DELETE", f"/api/clips/{opened['clip']}")
    assert await page.refused("GET", f"/api/clips/{opened['clip']}") == "CLIP_NOT_OPEN"
    again = await page.do("/api/clips", {"records": pictures[:1]})
    (seal,) = (await page.do(f"/api/clips/{again['clip']}/verdict"))["seals"]
    assert seal["verdict_height"] > seal["record_height"]
    assert all(check["ok"] for check in seal["checks"])
    record = await page.settle(lambda told: told["verdict"], f"/api/records/{pictures[0]}")
    assert record["verdict"] == "verified"
    story = await page.get("/api/audit-events")
    assert {"recorded", "access_requested", "visit_opened", "verdict"} <= {event["kind"] for event in story["events"]}


async def _consent(page: WalletPage) -> None:
    consents = await page.get("/api/consents")
    assert [(row["purpose"], row["holds_now"]) for row in consents["choices"]] == [("demo", True)]
    version = consents["notice"]["version"]
    wrong = {"purposes": ["care"], "sensors": ["depth"], "notice_version": version + 1}
    assert (await page.follow(await page.post("/api/consents/give", wrong)))["error"]["code"] == "NOTICE_NOT_SHOWN"
    said = await page.do("/api/consents/give", wrong | {"notice_version": version})
    assert said["receipt"]["signed_by"]
    await page.do("/api/consents/withdraw", {"purposes": ["care"], "sensors": []})
    receipts = await page.get("/api/consents/receipts")
    assert [row["status"] for row in receipts["receipts"]][-2:] == ["given", "withdrawn"]


async def _share_and_revoke(page: WalletPage, rows: list[dict[str, Any]], handle: str) -> None:
    until_ms = time.time_ns() // 1_000_000 + DAY_MS
    wish = {
        "records": [rows[0]["record_id"]],
        "with": handle,
        "name": "Dr Weber",
        "purpose": "demo",
        "until_ms": until_ms,
    }
    plan = await page.post("/api/shares/plan", wish)
    assert (plan["grantee"]["role"], plan["records"]) == ("staff", 1)
    assert any("What cannot be undone" in line for line in plan["lines"])
    assert await page.refused("POST", "/api/shares", wish) == "REQUEST_INVALID"
    assert await page.refused("POST", "/api/shares", wish | {"passphrase": "coffee"}) == "WALLET_PASSPHRASE_WRONG"
    (shared,) = (await page.do("/api/shares", wish | {"passphrase": PASSPHRASE}))["shared"]
    told = await page.settle(lambda told: told["shares"], "/api/shares")
    assert [(share["name"], share["status"]) for share in told["shares"]] == [("Dr Weber", "open")]
    await page.do(f"/api/shares/{shared['grant_id']}/revoke")
    await page.settle(lambda told: told["shares"][0]["status"] == "revoked", "/api/shares")
    assert (await page.get("/api/inbox"))["alarms"] == []


async def _export(page: WalletPage, folder: Path, ward: Ward) -> None:
    plan = await page.post("/api/exports/plan", {})
    assert plan["records"] > 2
    done = await page.do("/api/exports", {"now": True, "passphrase": PASSPHRASE})
    content = await page.get(f"/api/exports/{done['export']}/file")
    assert len(content) == done["bytes"]
    assert zipfile.ZipFile(io.BytesIO(content)).testzip() is None
    taken = folder / done["name"]
    taken.write_bytes(content)
    verdict = await asyncio.to_thread(verify_bundle, taken, ward.genesis)
    assert len(verdict.records) == done["records"]
    await page.ask("DELETE", f"/api/exports/{done['export']}")
    assert await page.refused("GET", f"/api/exports/{done['export']}/file") == "NOT_FOUND"


async def _erase(page: WalletPage, rows: list[dict[str, Any]]) -> None:
    gone = rows[0]["record_id"]
    plan = await page.post("/api/erasures/plan", {"records": [gone]})
    assert (plan["records"], plan["visits"]) == ([gone], 1)
    assert [share["name"] for share in plan["recipients"]] == ["Dr Weber"]
    accepted = await page.post("/api/erasures", {"records": [gone], "passphrase": PASSPHRASE})
    job = await page.follow(accepted)
    assert job["result"]["complete"]
    assert all(row["confirmed_at_ms"] for row in job["receipts"])
    told = await page.settle(lambda told: told["erasures"][0]["status"] == "complete", "/api/erasures")
    assert told["erasures"][0]["records"] == 1
    await page.settle(lambda told: told["total"] == len(rows) - 1, "/api/records")
    assert await page.refused("GET", f"/api/records/{gone}") == "NOT_FOUND"


async def _lose_a_node(page: WalletPage, network: NetworkUnderTest) -> None:
    """Whichever node is away, another is asked, and the one that is away is named."""
    named = set()
    for name in network.names:
        network.cluster.stop(name)
        assert (await page.get("/api/consents"))["height"] > 0
        nodes = (await page.get("/api/overview"))["network"]["nodes"]
        named |= {(node["name"], node["state"]) for node in nodes if node["state"] != "fine"}
        network.cluster.start(name)
        await network.cluster.wait_ready()
    assert named
    assert {state for _, state in named} == {"unreachable"}

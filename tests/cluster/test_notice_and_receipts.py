"""A hospital tells people on real nodes: she reads, consents, has receipts; the words change, and she is told."""

from __future__ import annotations

import asyncio
import json
import os
import sys
from pathlib import Path
from typing import Any

import pytest

from clients.registrar.registrar import Registrar
from clients.wallet.store.keystore import Keystore
from clients.wallet.store.member_keys import draw_words
from network.notices.notice_publishing import demo_notice, demo_notice_text
from tests.cluster.commands import must, run
from tests.cluster.network_under_test import NetworkUnderTest
from tests.world.dicts import CHEAP

UID = "E200001D8914AB12"
TIMEOUT_S = 60


class Ann:
    """Her wallet, as she uses it: commands, each a process that knows the genesis file alone."""

    def __init__(self, network: NetworkUnderTest, folder: Path) -> None:
        self._network = network
        self._folder = folder
        (folder / "passphrase").write_text("tea")
        Keystore.create(folder / "ann.wallet", draw_words(), "tea", CHEAP)

    async def run(self, *arguments: str) -> str:
        genesis = str(self._network.folder / "genesis.json")
        command = [sys.executable, "-m", "network.cli.main", "wallet", "--wallet-dir", str(self._folder)]
        process = await asyncio.create_subprocess_exec(
            *command,
            *("--profile", "ann", "--genesis", genesis, *arguments),
            env=os.environ | {"BLOCKROBOT_PASSPHRASE_FILE": str(self._folder / "passphrase"), "COLUMNS": "1000"},
            stdout=asyncio.subprocess.PIPE,
        )
        output, _ = await asyncio.wait_for(process.communicate(), TIMEOUT_S)
        assert process.returncode == 0, output.decode()
        return output.decode()

    async def ask(self, *arguments: str) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(await self.run(*arguments, "--json"))
        return found


@pytest.fixture
def ann(network: NetworkUnderTest, tmp_path: Path) -> Ann:
    return Ann(network, tmp_path)


async def test_she_is_told_consents_has_receipts_and_is_told_again_when_it_changes(
    network: NetworkUnderTest, ann: Ann, tmp_path: Path
) -> None:
    genesis, place = network.genesis, tmp_path / "notice.toml"
    place.write_text(demo_notice_text())
    first = await must(network, "notice", "publish", str(place), "--as", "hospital", "--yes")
    code = Registrar(network.folder / "organisations" / "hospital", genesis).issue(UID, "subject")

    told = await ann.run("register", code, "--purpose", "demo", "--yes")
    assert told.index(demo_notice().authority.contact) < told.index("You are registered"), "the words come first"
    given = await ann.ask("consent", "give", "--purpose", "care")
    changed = demo_notice_text().replace("there is no profiling", "no profile is made")
    assert changed != demo_notice_text()
    place.write_text(changed)
    second = await must(network, "notice", "publish", str(place), "--as", "hospital", "--yes")
    line = await ann.run("records")
    diff = await ann.ask("notice")
    choices = await ann.ask("consent", "list")
    again = await ann.ask("consent", "give", "--purpose", "care", "--yes")
    withdrawn = await ann.ask("consent", "withdraw")
    quiet = await ann.ask("records")
    listed = await ann.ask("consent", "receipts", "--out", str(tmp_path / "receipts.json"))
    receipts = str(tmp_path / "receipts.json")
    _, checked = await run("verify", receipts, "--genesis", genesis.block_id.hex(), "--json")
    register = await must(network, "notice", "activities", "--as", "hospital")

    assert [(each["version"], each["is_new"]) for each in (first, second)] == [(1, True), (2, True)]
    assert given["receipt"]["notice_version"] == 1
    assert given["notice"] is None, "it was on her screen when she registered"
    assert "What hospital tells you changed since you consented" in line
    assert (diff["consented_version"], diff["version"], len(diff["changes"])) == (1, 2, 2)
    assert {row["holds_now"] for row in choices["choices"]} == {True}, "a changed notice ends no consent"
    assert (again["receipt"]["notice_version"], withdrawn["receipt"]["notice_version"]) == (2, 2)
    assert quiet["notice_changed_to"] is None
    states = [row["events"][0]["event_state"] for row in listed["receipts"]]
    assert states == ["given", "given", "given", "withdrawn"]
    assert listed["missing"] == []
    assert (checked["ok"], checked["is_anchored"], checked["consent_receipts"]) == (True, True, 4)
    owners = {node["organisation"] for node in (await must(network, "org", "list"))["nodes"]}
    assert owners == {"hospital", "university"}
    assert {row["organisation"] for row in checked["signed_consent_receipts"]} == {"hospital"}
    assert register["notice"]["version"] == 2
    assert register["other_keepers"] == ["university"]


async def test_a_wallet_made_again_from_its_words_finds_its_receipts(
    network: NetworkUnderTest, ann: Ann, tmp_path: Path
) -> None:
    genesis = network.genesis
    code = Registrar(network.folder / "organisations" / "hospital", genesis).issue(UID, "subject")
    told = await ann.run("register", code, "--purpose", "demo", "--yes")
    assert "hospital has published no privacy notice" in told
    await ann.ask("consent", "withdraw")
    store = Keystore.open(tmp_path / "ann.wallet", "tea")
    (tmp_path / "ann.wallet").unlink()
    Keystore.create(tmp_path / "ann.wallet", store.content.words, "tea", CHEAP)
    assert (await ann.ask("consent", "receipts"))["receipts"] == []
    found = await ann.ask("consent", "receipts", "--search")
    assert [row["events"][0]["event_state"] for row in found["receipts"]] == ["given", "withdrawn"]

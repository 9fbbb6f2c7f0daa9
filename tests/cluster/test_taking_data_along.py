"""A person takes along what a real network holds of her; then the network is gone, and a stranger checks the file."""

from __future__ import annotations

import asyncio
import json
import zipfile
from pathlib import Path

import numpy as np

from clients.sdk.pictures.rendition_picture import decode_colour_png, decode_depth_png
from clients.wallet.consent.consent_choices import ConsentClient
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.records.erasure import ErasureClient
from tests.cluster.commands import run
from tests.cluster.network_under_test import NetworkUnderTest
from tests.cluster.test_rights import Ward
from tests.walking_alone import UID


async def _erase_one(wallet: Wallet) -> str:
    (report,) = await wallet.records()
    entry = report.records[0]
    erasing = ErasureClient(wallet)
    ids = await erasing.request(entry.visit, [entry.record_id], [])
    await erasing.wait_complete([(entry.visit, ids)], timeout_s=30)
    return entry.record_id.hex()


def _look_at(bundle: Path, count: int) -> None:
    """Pictures are there in order, and show somebody: the person's own pixels stand in front of the empty room."""
    with zipfile.ZipFile(bundle) as packed:
        pictures = [name for name in packed.namelist() if name.startswith("pictures/")]
        depths = [name for name in packed.namelist() if name.startswith("depth/")]
        assert (len(pictures), len(depths)) == (count, count)
        assert pictures == sorted(pictures)
        shown = decode_colour_png(packed.read(pictures[0]))
        own = decode_depth_png(packed.read(depths[0]))
        room = decode_depth_png(packed.read(next(name for name in packed.namelist() if "backgrounds/" in name)))
    assert shown.shape == (480, 640, 3)
    assert 1_000 < np.count_nonzero(own) < own.size // 2
    assert np.median(own[own > 0]) < np.median(room[own > 0])


async def test_a_bundle_outlives_the_network_it_is_from(network: NetworkUnderTest, tmp_path: Path) -> None:
    home, bundle, genesis_file = tmp_path / "home", tmp_path / "mine.zip", tmp_path / "genesis.json"
    (home / "wallets").mkdir(parents=True)
    (home / "passphrase").write_text("tea\n")
    genesis_file.write_bytes((network.folder / "genesis.json").read_bytes())
    ward = Ward(network, home / "wallets")
    async with ward.wallet("default") as wallet:
        await wallet.register(ward.desk.issue(UID, "subject"), ["demo"])
        await ward.prepare_robot()
        assert (await ward.record()).kept > 0
        await ConsentClient(wallet).give(["care"], ["rgb"])
        await ConsentClient(wallet).withdraw(["care"], ["rgb"])
        erased = await _erase_one(wallet)
    command = ("wallet", "--genesis", genesis_file, "export", bundle, "--yes", "--json")
    code, exported = await run(*command, home=home)
    assert (code, exported["ok"], exported["problems"]) == (0, True, []), exported
    assert (await run(*command, home=home))[1]["error"]["code"] == "FILE_EXISTS"

    network.cluster.stop_all()
    nowhere = tmp_path / "nowhere"
    nowhere.mkdir()
    code, told = await run("verify", bundle, "--genesis", genesis_file, "--json", home=nowhere)
    assert (code, told["is_anchored"], told["is_complete"]) == (0, True, True), told
    assert told["pictures"] == exported["pictures"] > 5
    assert told["metadata_proved"] == told["records"] - 1
    assert told["erasures"] == 1
    assert told["accesses"] == 1
    assert told["consent_receipts"] == 2
    assert [row["status"] for row in told["signed_consent_receipts"]] == ["given", "given", "withdrawn"]
    assert not any("in block" in line for line in told["not_proved"])
    with zipfile.ZipFile(bundle) as packed:
        (erasure,) = json.loads(packed.read("data/erasures.json"))["erasures"]
    assert (erasure["records"], erasure["status"], len(erasure["receipts"])) == ([erased], "complete", 2)
    await asyncio.to_thread(_look_at, bundle, told["pictures"])

    content = bytearray(bundle.read_bytes())
    content[len(content) // 2] ^= 1
    bundle.write_bytes(content)
    code, told = await run("verify", bundle, "--genesis", genesis_file, "--json", home=nowhere)
    assert (code, told["ok"], told["error"]["code"]) == (1, False, "BUNDLE_INVALID")

"""`blockrobot node diff` and `node snapshot` as a user meets them: exit codes, names, one JSON object."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

import lmdb
import pytest
from click.testing import CliRunner

from consensus.primitives.encoding import encode_value
from network.cli.main import main
from network.provisioning.network_layout import create_network
from node.components import begin_ledger
from node.config import load_config
from node.storage.lmdb_store import LmdbStore

KEY = b"producers\x00epoch"


@pytest.fixture
def network(tmp_path: Path) -> Path:
    """Two nodes that have stored genesis and were stopped."""
    genesis = create_network(tmp_path / "network", nodes=2, organisations=1, base_port=46_480)

    async def begin(ledger_dir: Path) -> None:
        store = LmdbStore.create(ledger_dir)
        await begin_ledger(store, genesis)
        await store.close()

    for name in ("node-1", "node-2"):
        asyncio.run(begin(load_config(tmp_path / "network" / "nodes" / name).ledger_dir))
    return tmp_path / "network"


def run(network: Path, *arguments: str) -> tuple[int, dict[str, Any]]:
    result = CliRunner().invoke(main, ["node", *arguments, "--dir", str(network), "--json"])
    return result.exit_code, json.loads(result.stdout)


def test_two_nodes_that_agree_exit_with_0(network: Path) -> None:
    code, report = run(network, "diff", "node-1", str(network / "nodes" / "node-2"), "--full")
    assert (code, report["ok"], report["kind"]) == (0, True, "none")


def test_a_meddled_ledger_is_named_with_exit_code_1(network: Path) -> None:
    environment = lmdb.open(str(network / "nodes" / "node-2" / "ledger"), max_dbs=20, map_size=1 << 30)
    with environment.begin(write=True) as transaction:
        state = environment.open_db(b"state", txn=transaction, create=False)
        transaction.put(KEY, encode_value({"number": 7}), db=state)
    environment.close()
    code, report = run(network, "diff", "node-1", "node-2")
    (key,) = report["keys"]
    assert (code, report["ok"], report["kind"]) == (1, False, "state")
    assert (key["contract"], key["key"], key["right"]) == ("producers", "epoch", "A")
    assert key["values"]["B"] == "{'number': 7}"
    told = CliRunner().invoke(main, ["node", "diff", "node-1", "node-2", "--dir", str(network)])
    assert told.exit_code == 1
    assert "Key epoch of contract producers" in told.output


def test_nodes_of_two_networks_or_of_none_are_not_compared(network: Path, tmp_path: Path) -> None:
    create_network(tmp_path / "other", nodes=1, organisations=1, base_port=46_490)
    code, report = run(network, "diff", "node-1", str(tmp_path / "other" / "nodes" / "node-1"))
    assert (code, report["error"]["code"]) == (1, "SNAPSHOT_OTHER_CHAIN")
    code, report = run(network, "diff", "node-1", "node-9")
    assert (code, report["error"]["code"]) == (3, "NOT_FOUND")
    code, report = run(network, "snapshot", "create", str(tmp_path), "--out", str(tmp_path / "x"))
    assert report["error"]["code"] == "DATA_DIRECTORY_INVALID"


def test_a_snapshot_is_made_shown_and_not_taken_for_newer(network: Path, tmp_path: Path) -> None:
    place = str(tmp_path / "snapshot")
    code, made = run(network, "snapshot", "create", "node-1", "--out", place)
    assert (code, made["height"], made["names_its_proof"]) == (0, 0, True)
    assert run(network, "snapshot", "create", "node-1", "--out", place)[1]["error"]["code"] == "FOLDER_NOT_EMPTY"
    shown = CliRunner().invoke(
        main, ["node", "snapshot", "show", place, "--genesis", str(network / "genesis.json"), "--json"]
    )
    assert json.loads(shown.stdout)["verified"] is True
    assert run(network, "snapshot", "restore", "node-2", place)[1]["error"]["code"] == "SNAPSHOT_OLD"
    assert run(network, "prune", "node-2", "--keep", "256")[1]["earliest_height"] == 0

"""A file of somebody else that is larger than memory is refused with a code and the limit: nobody reads it whole."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from clients.bundle.checks.consent_receipts import check_file as check_receipts
from clients.robot.pairing.rosters import load_roster
from clients.robot.synthetic.scenario import load_scenario
from clients.sdk.new_files import read_given_text
from clients.sdk.terminal.terminal import load_genesis
from clients.wallet.store.keystore import Keystore
from consensus.errors import BlockRobotError
from contracts.kit.sources import read_source
from network.cli.governance.governance_signer import read_private_key
from network.cli.main import main
from network.custody.traces import read_traces
from network.experiments.log_files import read_log
from network.provisioning.exchange_files import read_certificate, read_node_entry
from network.provisioning.network_layout import create_network
from tests.cluster.network_under_test import find_base_port

HUGE_BYTES = 6 * 1024**3
READERS: dict[str, Callable[[Path], object]] = {
    "FILE_UNUSABLE genesis": load_genesis,
    "FILE_UNUSABLE text": read_given_text,
    "FILE_UNUSABLE key": read_private_key,
    "FILE_UNUSABLE certificate": read_certificate,
    "FILE_UNUSABLE entry": read_node_entry,
    "FILE_UNUSABLE contract": read_source,
    "RECEIPT_FILE_DAMAGED receipts": check_receipts,
    "FILE_UNUSABLE traces": read_traces,
    "FILE_UNUSABLE log": read_log,
    "FILE_UNUSABLE roster": lambda path: load_roster(path, Any, Any, 0),
    "CONFIGURATION_INVALID scenario": load_scenario,
    "WALLET_DAMAGED wallet": lambda path: Keystore.open(path, "x"),
}


@pytest.fixture
def huge(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    path = tmp_path / "huge.py"
    with path.open("wb") as file:
        file.truncate(HUGE_BYTES)
    read = Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda own: pytest.fail("it is read whole") if own == path else read(own))
    return path


@pytest.mark.parametrize("reader", READERS)
def test_a_file_larger_than_memory_is_refused_by_every_reader(reader: str, huge: Path) -> None:
    with pytest.raises(BlockRobotError, match=f"^{reader.split(maxsplit=1)[0]}: .*large"):
        READERS[reader](huge)


@pytest.mark.parametrize(
    "command",
    [
        ("verify", "{huge}", "--genesis", "{huge}"),
        ("contract", "check", "{huge}"),
        ("officer", "correction", "{huge}"),
        ("node", "init", "node-9", "--organisation", "org", "--genesis", "{huge}"),
        ("card", "issue", "--role", "subject", "--uid-file", "{huge}"),
        ("wallet", "restore", "--words-file", "{huge}"),
    ],
    ids=lambda command: " ".join(command[:2]),
)
def test_a_command_tells_that_its_file_is_too_large(
    command: tuple[str, ...], huge: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BLOCKROBOT_HOME", str(tmp_path / "home"))
    done = CliRunner().invoke(main, [part.format(huge=huge) for part in (*command, "--json")])
    problem = json.loads(done.stdout)["error"]
    assert problem["code"] == "FILE_UNUSABLE"
    assert "is larger than" in problem["detail"]


def test_a_directory_of_nodes_that_is_too_large_is_told(huge: Path, tmp_path: Path) -> None:
    create_network(tmp_path / "network", nodes=2, organisations=1, base_port=find_base_port(2))
    where = (
        "--genesis",
        tmp_path / "network" / "genesis.json",
        "--data-dir",
        tmp_path / "new",
        "--authority",
        tmp_path,
    )
    arguments = ("node", "init", "node-9", "--organisation", "org", *where, "--directory", huge, "--json")
    problem = json.loads(CliRunner().invoke(main, list(map(str, arguments))).stdout)["error"]
    assert problem["code"] == "FILE_UNUSABLE"
    assert "is larger than" in problem["detail"]

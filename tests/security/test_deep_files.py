"""A file of somebody else that is nested deeply, or names long keys, is refused with a code: by every reader, in time."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from clients.officer.mandate_papers import read_receipt
from clients.robot.sources.messages.topics import load_topics
from clients.robot.synthetic.scenario import load_scenario
from clients.sdk.terminal.terminal import load_genesis
from clients.wallet.records.rights_requests import read_correction
from consensus.errors import BlockRobotError
from network.cli.governance.notice_commands import read_notice_file
from network.custody.traces import read_traces
from network.faults.plan import parse_plan
from network.provisioning.exchange_files import read_node_entry, read_organisation_entry
from network.sim.plan_file import load_plan
from node.config import load_config
from node.directory.directory_file import decode_directory

REFUSED_MAX_S = 5.0
DEEP_JSON = {"arrays": "[" * 100_000, "objects": '{"a":' * 40_000}
DEEP_TOML = {"arrays": "a = " + "[" * 100_000, "key": ".".join(["a"] * 100_000) + " = 1"}
OF_JSON: dict[str, Callable[[Path], object]] = {
    "FILE_UNUSABLE organisation": read_organisation_entry,
    "FILE_UNUSABLE node": read_node_entry,
    "FILE_UNUSABLE correction": lambda path: read_correction(path.read_bytes()),
    "FILE_UNUSABLE traces": read_traces,
    "MANDATE_PAPERS_OTHER papers": read_receipt,
    "CONFIGURATION_INVALID directory": lambda path: decode_directory(path.read_bytes(), b""),
    "GENESIS_INVALID genesis": load_genesis,
}
OF_TOML: dict[str, Callable[[Path], object]] = {
    "NOTICE_INVALID notice": read_notice_file,
    "TOPICS_INVALID topics": load_topics,
    "CONFIGURATION_INVALID scenario": load_scenario,
    "FAULT_PLAN_INVALID faults": lambda path: parse_plan(path.read_text(), ["node-1"]),
    "CONFIGURATION_INVALID sim": load_plan,
    "CONFIGURATION_INVALID node": lambda path: load_config(path.parent),
}


@pytest.mark.parametrize("text", DEEP_JSON.values(), ids=DEEP_JSON)
@pytest.mark.parametrize("reader", OF_JSON)
def test_json_nested_deeply_is_refused_with_a_code(reader: str, text: str, tmp_path: Path) -> None:
    refused(OF_JSON[reader], reader.split(maxsplit=1)[0], text, tmp_path)


@pytest.mark.parametrize("text", DEEP_TOML.values(), ids=DEEP_TOML)
@pytest.mark.parametrize("reader", OF_TOML)
def test_toml_nested_deeply_is_refused_with_a_code(reader: str, text: str, tmp_path: Path) -> None:
    refused(OF_TOML[reader], reader.split(maxsplit=1)[0], text, tmp_path)


def refused(read: Callable[[Path], object], code: str, text: str, folder: Path) -> None:
    path = folder / "node.toml"
    path.write_text(text, encoding="utf-8")
    before = time.process_time()
    with pytest.raises(BlockRobotError, match=f"^{code}:"):
        read(path)
    assert time.process_time() - before < REFUSED_MAX_S

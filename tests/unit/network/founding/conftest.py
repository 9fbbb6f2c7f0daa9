"""Three parties and what they handed over to found a network."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from consensus.chain.genesis import Genesis, genesis_to_json
from contracts.execution.genesis import complete_genesis
from network.cli.governance.genesis_commands import genesis as genesis_group
from network.cli.governance.org_commands import org
from network.cli.node.node_setup_commands import init
from network.provisioning.founding import make_genesis
from network.provisioning.founding_entries import read_offers

PARTIES = {"hospital": ("ward-1", "ward-10"), "university": ("lab-1",), "clinic": ("ward-2",)}
"""Who founds, and with which nodes."""
Change = Callable[[dict[str, Any]], None]


def run(command: Any, *arguments: str) -> Result:
    return CliRunner(env={"COLUMNS": "160"}).invoke(command, list(arguments))


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Each party's folder, and what they handed over in `handed`."""
    place = tmp_path_factory.mktemp("founding")
    (place / "handed").mkdir()
    for number, (owner, nodes) in enumerate(PARTIES.items(), 1):
        home = place / owner
        assert run(org, "new", owner, "--dir", str(home)).exit_code == 0
        hand_over(home / "organisations" / owner / "organisation-entry.json", place / "handed" / f"{owner}.json")
        for node in nodes:
            address = ("--bind", f"10.0.{number}.1") if node != "ward-10" else ("--bind", "fd00::1", "--follower")
            said = run(init, node, "--founding", "--organisation", owner, "--dir", str(home), "--custodian", *address)
            assert said.exit_code == 0, said.output
            hand_over(home / "nodes" / node / "node-entry.json", place / "handed" / f"{node}.json")
    return place


def hand_over(path: Path, to: Path) -> None:
    to.write_bytes(path.read_bytes())


@pytest.fixture
def handed(world: Path, tmp_path: Path) -> dict[str, Path]:
    """The files of a party that has all of them, which a test may change."""
    for path in (world / "handed").iterdir():
        hand_over(path, tmp_path / path.name)
    return {path.stem: path for path in tmp_path.iterdir()}


def made_of(*paths: Path) -> Genesis:
    return make_genesis(*read_offers(paths))


def change(path: Path, how: Change) -> Path:
    document = json.loads(path.read_text())
    how(document)
    path.write_text(json.dumps(document))
    return path


def checked(genesis: Genesis, place: Path, *options: str) -> Result:
    path = place / "shown.json"
    path.write_text(genesis_to_json(complete_genesis(genesis)))
    return run(genesis_group, "check", str(path), "--dir", str(place / "nobody"), *options)

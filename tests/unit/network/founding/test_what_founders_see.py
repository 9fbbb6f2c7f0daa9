"""What founders compare before they agree, and what they are warned of."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner, Result

from clients.sdk.terminal.terminal import console
from consensus.chain.genesis import ChainSettings, genesis_from_json
from network.cli.governance.genesis_commands import genesis as genesis_group
from network.cli.node.node_run_commands import run as node_run
from network.cli.node.node_setup_commands import init
from tests.unit.network.founding.conftest import checked, made_of, run


def test_a_founder_sees_all_that_is_agreed_to(
    handed: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(console, "_width", 200)
    true = made_of(*handed.values())
    said = checked(true, tmp_path)
    assert "Settings: all are the default." in said.output
    assert "Purposes: care, companionship" in said.output
    assert "Begins: 20" in said.output
    (hospital,) = [owner for owner in true.organisations if owner.name == "hospital"]
    assert all(key.hex()[:16] in said.output for key in (*hospital.admins, *hospital.registrars))
    answer = json.loads(checked(true, tmp_path, "--json").stdout)
    assert answer["settings"] == msgspec.structs.asdict(ChainSettings())
    assert answer["changed_settings"] == answer["warnings"] == []
    assert answer["begins_ms"] == true.created_at_ms
    assert answer["purposes"] == list(true.purposes)
    (seen,) = [owner for owner in answer["organisations"] if owner["name"] == "hospital"]
    assert seen["admins"] == [key.hex() for key in hospital.admins]
    assert seen["registrars"] == [key.hex() for key in hospital.registrars]
    assert seen["nodes"] == seen["custodians"] == ["ward-1", "ward-10"]


def test_a_setting_that_somebody_slipped_in_is_seen(handed: dict[str, Path], tmp_path: Path) -> None:
    true = made_of(*handed.values())
    slow = ChainSettings(production="manual", max_clock_drift_ms=60_000)
    false = msgspec.structs.replace(true, settings=slow, purposes=("care",))
    said = checked(false, tmp_path).output
    assert "Settings that are not the default" in said
    for name, here, default in (("production", "manual", "on-demand"), ("max_clock_drift_ms", "60000", "5000")):
        (line,) = [line for line in said.splitlines() if name in line]
        assert here in line
        assert default in line
    assert "heartbeat_ms" not in said
    assert "Purposes: care\n" in said
    answer = json.loads(checked(false, tmp_path, "--json").stdout)
    assert answer["changed_settings"] == ["max_clock_drift_ms", "production"]
    assert answer["settings"]["production"] == "manual"


def test_at_80_columns_no_address_that_founders_compare_is_broken(handed: dict[str, Path], tmp_path: Path) -> None:
    arguments = ["make", *map(str, handed.values()), "--out", str(tmp_path / "1.json")]
    said = CliRunner(env={"COLUMNS": "80"}).invoke(genesis_group, arguments).output
    lines = [line.split() for line in said.splitlines()]
    for node in genesis_from_json((tmp_path / "1.json").read_bytes()).nodes:
        host = f"[{node.host}]" if ":" in node.host else node.host
        assert ["peers", f"{host}:{node.p2p_port}"] in lines
        assert ["clients", node.api_url] in lines


def test_an_organisation_whose_nodes_entry_was_left_out_is_warned_of(handed: dict[str, Path], tmp_path: Path) -> None:
    del handed["ward-2"]

    def make(name: str, *options: str) -> Result:
        return run(genesis_group, "make", *map(str, handed.values()), "--out", str(tmp_path / name), *options)

    said = make("1.json")
    assert said.exit_code == 0
    assert "warning FOUNDER_WITHOUT_NODE: clinic founds without a node" in said.output
    (warning,) = json.loads(make("2.json", "--json").stdout)["warnings"]
    assert warning["code"] == "FOUNDER_WITHOUT_NODE"
    said = run(genesis_group, "check", str(tmp_path / "1.json"), "--dir", str(tmp_path / "empty"))
    assert "warning FOUNDER_WITHOUT_NODE: clinic" in said.output, "and whoever compares the file is warned too"
    assert "warning" not in make("3.json", "--without-node", "clinic").output
    assert make("4.json", "--without-node", "nobody").exit_code == 2
    assert not (tmp_path / "4.json").exists()


def test_a_node_that_others_could_not_reach_is_warned_of(world: Path, handed: dict[str, Path], tmp_path: Path) -> None:
    def warned(*paths: Path) -> list[str]:
        out = tmp_path / "genesis.json"
        out.unlink(missing_ok=True)
        made = run(genesis_group, "make", *map(str, paths), "--out", str(out), "--json")
        checked = run(genesis_group, "check", str(out), "--dir", str(tmp_path / "empty"), "--json")
        found = json.loads(made.stdout)["warnings"]
        assert json.loads(checked.stdout)["warnings"] == found
        return [f"{warning['code']}: {warning['detail']}" for warning in found]

    home = tmp_path / "home"
    shutil.copytree(world / "clinic", home)
    assert run(init, "near", "--founding", "--organisation", "clinic", "--dir", str(home)).exit_code == 0
    near = home / "nodes" / "near" / "node-entry.json"
    assert warned(handed["clinic"], near) == [], "all on one machine"
    assert warned(handed["clinic"], handed["ward-2"]) == []
    (warning,) = warned(handed["clinic"], handed["ward-2"], near)
    assert warning.startswith("FOUNDER_ADDRESS_LOCAL: near is reached at 127.0.0.1")


def test_a_founding_node_made_by_mistake_may_be_made_anew(world: Path) -> None:
    said = run(init, "ward-2", "--founding", "--organisation", "clinic", "--dir", str(world / "clinic"))
    assert "NODE_EXISTS" in said.output
    assert "has no genesis.json yet" in said.output


def test_a_founder_is_told_what_comes_before_a_command(world: Path, tmp_path: Path) -> None:
    said = run(init, "ward-1", "--founding", "--organisation", "nobody", "--dir", str(tmp_path))
    assert "ORGANISATION_KEY_NOT_FOUND" in said.output
    assert "blockrobot org new NAME" in said.output
    home = tmp_path / "home"
    shutil.copytree(world / "clinic", home)
    for path in home.rglob("genesis.json"):
        path.unlink()
    for options in ([], ["--detach"]):
        said = run(node_run, "ward-2", "--dir", str(home), *options)
        assert "NETWORK_NOT_FOUNDED" in said.output
        assert "blockrobot genesis check FILE --adopt" in said.output

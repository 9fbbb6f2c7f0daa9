"""Faults of nodes that are down are kept in their files; a network that allows none is left alone, whole."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from pathlib import Path
from typing import get_args

import pytest
from aiohttp import web
from aiohttp.test_utils import TestServer

from consensus.errors import BlockRobotError
from network.cluster import Cluster
from network.faults.actions import (
    Action,
    FillDisk,
    GoByzantine,
    Heal,
    Kill,
    Partition,
    Pause,
    Restart,
    Resume,
    SetLink,
    Skew,
)
from network.faults.control import FaultControl
from network.faults.plan import parse_plan
from network.faults.requested import StepDone, run_plan
from network.provisioning.network_layout import create_network
from node.faults import STATE_FILE_NAME, TOKEN_FILE_NAME
from node.p2p.link_faults import LinkFault

HALVES = Partition((("node-1", "node-2"), ("node-3",)))
EVERY_ACTION: tuple[Action, ...] = (
    HALVES,
    Heal(),
    Heal(("node-2",)),
    Kill("node-1"),
    Pause("node-1"),
    Resume("node-1"),
    Restart("node-1"),
    Skew("node-1", 5),
    FillDisk("node-1", "ledger"),
    SetLink("node-1", "node-2", LinkFault(cut=True)),
    SetLink("node-1", "node-2", LinkFault(cut=True), is_both=True),
    GoByzantine("node-1", "garbage"),
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("faults") / "network"
    create_network(folder, nodes=3, organisations=1, base_port=46_810, faults=True)
    return folder


@pytest.fixture
def control(folder: Path) -> FaultControl:
    control = FaultControl(Cluster(folder), seed=11)
    asyncio.run(control.carry_out(Heal()))
    return control


def _do(control: FaultControl, *actions: Action) -> dict[str, list[str]]:
    async def work() -> dict[str, list[str]]:
        for action in actions:
            await control.carry_out(action)
        return {row.name: row.describe() for row in await control.state()}

    return asyncio.run(work())


def test_a_partition_cuts_both_ends_and_the_next_one_takes_its_place(control: FaultControl) -> None:
    assert _do(control, HALVES) == {
        "node-1": ["down", "-> node-3: cut"],
        "node-2": ["down", "-> node-3: cut"],
        "node-3": ["down", "-> node-1: cut", "-> node-2: cut"],
    }
    slow = SetLink("node-1", "node-3", LinkFault(delay_ms=9))
    assert _do(control, slow, HALVES, Partition((("node-1",), ("node-2", "node-3")))) == {
        "node-1": ["down", "-> node-2: cut", "-> node-3: cut"],
        "node-2": ["down", "-> node-1: cut"],
        "node-3": ["down", "-> node-1: cut"],
    }
    everybody = Partition((tuple(control.cluster.names),))
    assert _do(control, everybody)["node-1"] == ["down", "-> node-3: 9 ms"]


def test_faults_of_one_node_are_kept_for_its_next_start_and_healed(control: FaultControl) -> None:
    said = _do(control, Skew("node-2", 3_600_000), FillDisk("node-2", "journal"), FillDisk("node-2", "custody"))
    assert said["node-2"] == ["down", "clock +1h", "custody disk full", "journal disk full"]
    assert _do(control, FillDisk("node-2", "custody", is_full=False))["node-2"][2:] == ["journal disk full"]
    assert _do(control, Heal(("node-2",)))["node-2"] == ["down"]


def test_healing_one_node_mends_the_links_of_others_to_it(control: FaultControl) -> None:
    said = _do(control, HALVES, Heal(("node-3",)))
    assert said == {"node-1": ["down"], "node-2": ["down"], "node-3": ["down"]}


def test_a_link_has_its_seed_and_both_directions_if_asked(control: FaultControl) -> None:
    said = _do(control, SetLink("node-1", "node-2", LinkFault(loss=0.5), is_both=True))
    assert said["node-1"] == ["down", "-> node-2: 50.0% lost"]
    assert said["node-2"] == ["down", "-> node-1: 50.0% lost"]
    states = asyncio.run(control.state())
    assert states[0].switched is not None
    assert states[0].switched["seed"] == 11


@pytest.mark.parametrize("action", [Kill("node-1"), Pause("node-1")])
def test_who_is_down_cannot_be_killed_or_paused(control: FaultControl, action: Action) -> None:
    with pytest.raises(BlockRobotError, match=r"^FAULT_TARGET_ABSENT:"):
        _do(control, action)


def test_an_unknown_node_is_refused_and_every_action_tried_where_no_faults_are_allowed(control: FaultControl) -> None:
    with pytest.raises(BlockRobotError, match=r"^FAULT_UNKNOWN:"):
        _do(control, Kill("node-9"))
    assert {type(action) for action in EVERY_ACTION} == set(get_args(Action))


@pytest.mark.parametrize("action", EVERY_ACTION)
def test_a_network_that_allows_no_faults_is_left_alone(tmp_path: Path, action: Action) -> None:
    create_network(tmp_path, nodes=3, organisations=1, base_port=46_850)
    control = FaultControl(Cluster(tmp_path))
    with pytest.raises(BlockRobotError, match=r"^FAULTS_DISABLED:"):
        _do(control, action)
    assert not list(tmp_path.rglob(STATE_FILE_NAME))
    states = asyncio.run(control.state())
    assert {row.switched is None for row in states} == {True}
    assert not any(row.running for row in states)


def test_a_node_that_takes_no_faults_stands_in_nobodys_way(tmp_path: Path) -> None:
    create_network(tmp_path, nodes=3, organisations=1, base_port=46_890, faults=True)
    config = Cluster(tmp_path).config("node-2")
    path = config.data_dir / "node.toml"
    path.write_text(path.read_text().replace("enabled = true", "enabled = false"))
    control = FaultControl(Cluster(tmp_path))
    for refused_action in (Kill("node-2"), HALVES, Heal(("node-2",))):
        with pytest.raises(BlockRobotError, match="FAULTS_DISABLED"):
            _do(control, refused_action)
    assert _do(control, Skew("node-1", 5), Heal())["node-1"] == ["down"]
    assert _do(control, Heal(("node-3",)))["node-3"] == ["down"]
    assert not (config.data_dir / STATE_FILE_NAME).exists()


def test_a_plan_is_carried_out_on_time_and_a_step_that_fails_is_told_and_not_the_end(control: FaultControl) -> None:
    text = "\n".join(
        f"[[step]]\nat = '{at}'\n{what}"
        for at, what in (
            ("0", "do = 'partition'\ngroups = 'node-1'"),
            ("20ms", "do = 'kill'\nnode = 'node-1'"),
            ("40ms", "do = 'heal'"),
        )
    )
    told: list[StepDone] = []
    done = asyncio.run(run_plan(parse_plan(text, control.cluster.names), control, told.append))
    assert done == told
    assert [None if item.error is None else item.error.code for item in done] == [None, "FAULT_TARGET_ABSENT", None]
    assert all(item.at_ms >= item.step.at_ms for item in done)
    assert {tuple(row.describe()) for row in asyncio.run(control.state())} == {("down",)}


@pytest.mark.parametrize("content", ["[]", "7", "{", "<html></html>"])
async def test_an_answer_in_another_form_is_not_called_silence(folder: Path, content: str) -> None:
    async def answer(_request: web.Request) -> web.Response:
        return web.Response(text=content, content_type="application/json")

    application = web.Application()
    application.router.add_get("/faults", answer)
    control = FaultControl(Cluster(folder), seed=11)
    config = control.cluster.config("node-1")
    (config.data_dir / TOKEN_FILE_NAME).write_text("5e" * 32)
    async with TestServer(application, host="127.0.0.1") as server:
        control.cluster.configs["node-1"] = replace(config, operator_port=server.port or 0)
        with pytest.raises(BlockRobotError) as refused:
            await control._ask("node-1", "GET", b"")
    assert refused.value.code == "INTERNAL"

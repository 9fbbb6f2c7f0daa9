"""The console at work, on a network that does not run: plans one at a time, and a folder that changes under it."""

from __future__ import annotations

import asyncio
import shutil
from pathlib import Path
from typing import Any

import pytest
from msgspec import to_builtins

from consensus.errors import BlockRobotError
from network.byzantine import BEHAVIOURS
from network.cluster import Cluster
from network.console.live import ForwardClock, LiveConsole
from network.console.node_polling import NodePoll, NodePoller
from network.provisioning.network_layout import create_network
from tests.unit.network.console.polls import polls

LOOKS_COUNT = 3
LONG_PLAN = 'seed = 4\n[[step]]\nat = "1h"\ndo = "pause"\nnode = "node-1"\n'


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("console") / "network"
    create_network(folder, nodes=4, organisations=2, base_port=20_000, store="sqlite", faults=True)
    return folder


@pytest.fixture
async def console(made: Path, tmp_path: Path) -> LiveConsole:
    folder = tmp_path / "network"
    shutil.copytree(made, folder)
    return LiveConsole(Cluster(folder))


async def test_the_page_is_told_who_is_who_and_what_there_is_to_choose(console: LiveConsole) -> None:
    facts, choices = to_builtins(console.facts()), to_builtins(console.choices())
    assert facts["quorum"] == 3
    assert facts["nodes"][0] == {
        "name": "node-1",
        "organisation": "hospital",
        "producer": True,
        "custodian": True,
        "breakable": True,
    }
    assert [behaviour["name"] for behaviour in choices["behaviours"]] == list(BEHAVIOURS)
    assert all(behaviour["meaning"].endswith(".") for behaviour in choices["behaviours"])
    assert choices["disks"] == ["journal", "ledger", "custody"]


async def test_who_waits_for_news_hears_of_a_moment_at_once(console: LiveConsole) -> None:
    await console.wait_beyond(0, 0.0)
    assert to_builtins(console.now(0))["moment"] is None
    console._update(polls())
    await console.wait_beyond(0, 60.0)
    answer = to_builtins(console.now(0))
    assert (answer["sequence"], answer["moment"]["final"]) == (1, 10)
    assert [event["number"] for event in answer["events"]] == [1]
    assert to_builtins(console.now(1))["events"] == []
    assert answer["recording"]["moments"] == 1


async def test_an_export_holds_what_was_recorded(console: LiveConsole) -> None:
    console._update(polls())
    text = console.export()
    assert '"final":10' in text
    assert "The recording begins" in text


async def test_one_plan_is_carried_out_at_a_time_and_can_be_stopped(
    console: LiveConsole, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(BlockRobotError) as caught:
        console.start_plan(LONG_PLAN)
    assert caught.value.code == "CLUSTER_NOT_RUNNING"
    monkeypatch.setattr(Cluster, "is_running", lambda _self, _name: True)
    assert to_builtins(console.start_plan(LONG_PLAN))["state"] == "running"
    with pytest.raises(BlockRobotError) as caught:
        console.start_plan(LONG_PLAN)
    assert caught.value.code == "FAULT_PLAN_RUNNING"
    await console.close()
    plan = to_builtins(console.now(0))["plan"]
    assert (plan["state"], plan["seed"], plan["steps"][0]["do"]) == ("stopped", 4, "pause node-1")
    assert "done_at_ms" not in plan["steps"][0]
    assert to_builtins(console.start_plan(LONG_PLAN))["state"] == "running"
    await console.close()


async def test_what_is_refused_is_told_on_the_time_line(console: LiveConsole, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Cluster, "is_running", lambda _self, name: name != "node-2")
    with pytest.raises(BlockRobotError) as caught:
        await console.do({"do": "kill", "node": "node-2"})
    assert caught.value.code == "FAULT_TARGET_ABSENT"
    told = [(event["kind"], event["text"]) for event in console.recorder.events_after(0)]
    assert told == [
        ("asked", "Asked: kill node-2."),
        ("asked", "Refused: kill node-2. FAULT_TARGET_ABSENT: node-2 is not running."),
    ]


async def test_nodes_that_come_or_go_in_the_folder_are_noticed(console: LiveConsole) -> None:
    assert not console._is_another()
    shutil.rmtree(console.cluster.folder / "nodes" / "node-4")
    assert console._is_another()
    console._begin_anew()
    assert not console._is_another()
    assert [node["name"] for node in to_builtins(console.facts())["nodes"]] == ["node-1", "node-2", "node-3"]
    assert console.recorder.events_after(0)[-1]["text"] == "The nodes are others now: node-1, node-2, node-3."


async def test_what_was_recorded_of_a_node_that_has_gone_since_is_shown_with_it_and_its_rounds_stay(
    console: LiveConsole, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_ms = iter(range(1_000, 100_000, 1_000))
    monkeypatch.setattr(console, "_now_ms", lambda: next(now_ms))
    said = {"status": {"rounds": [{"epoch": 0, "round": 7, "leader": "node-4", "messages": {"voted": 1}}]}}
    console._update(polls(node_4=said))
    shutil.rmtree(console.cluster.folder / "nodes" / "node-4")
    assert console._begin_anew()
    assert len(to_builtins(console.now(0))["network"]["nodes"]) == 4, "the newest moment is still one of four"
    assert console.recorder.events_after(0)[-1]["nodes"] == ["node-4"]
    console._update(polls()[:3])
    past, now = to_builtins(console.past(1_500)), to_builtins(console.now(0))
    assert [len(each["network"]["nodes"]) for each in (past, now)] == [4, 3]
    assert [round_["round"] for round_ in past["rounds"]] == [round_["round"] for round_ in now["rounds"]] == [7]
    assert to_builtins(console.past(0)) == past, "before the first look stands what it saw"
    assert now["recording"]["names"] == ["node-1", "node-2", "node-3", "node-4"]
    assert sum("The recording begins" in event["text"] for event in now["events"]) == 1


async def test_who_produces_and_what_a_quorum_is_goes_by_the_epoch_that_nodes_tell_of(console: LiveConsole) -> None:
    seats = {"status": {"epoch": 3, "quorum": 2, "producers": ["node-2", "node-3"]}}
    console._update(polls(node_2=seats))
    facts = to_builtins(console.facts())
    assert facts["quorum"] == 2
    assert [node["name"] for node in facts["nodes"] if node["producer"]] == ["node-2", "node-3"]


async def test_a_new_network_in_the_folder_ends_the_plan_and_is_not_shown_with_the_others_moment(
    console: LiveConsole, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Cluster, "is_running", lambda _self, _name: True)
    console._update(polls())
    console.start_plan(LONG_PLAN)
    folder = console.cluster.folder
    shutil.rmtree(folder)
    create_network(folder, nodes=3, organisations=1, base_port=20_100, store="sqlite", faults=True)
    assert console._is_another()
    assert console._begin_anew()
    await console.close()
    answer = to_builtins(console.now(0))
    assert answer["plan"]["state"] == "stopped"
    assert answer["moment"] is None
    assert answer["events"][-1]["text"] == "Another network stands in the folder now: node-1, node-2, node-3."


async def test_a_folder_that_cannot_be_read_is_looked_at_as_it_was_known(
    console: LiveConsole, monkeypatch: pytest.MonkeyPatch
) -> None:
    (console.cluster.folder / "genesis.json").write_text("{")
    looks = []

    async def look(_self: NodePoller) -> list[NodePoll]:
        looks.append(len(looks))
        return polls()

    await _watch(console, look, monkeypatch)
    assert len(looks) == LOOKS_COUNT
    assert len(to_builtins(console.facts())["nodes"]) == 4


async def test_a_node_that_says_nonsense_ends_no_recording_and_is_told_of_once(
    console: LiveConsole, monkeypatch: pytest.MonkeyPatch
) -> None:
    looks = []

    async def look(_self: NodePoller) -> list[NodePoll]:
        looks.append(len(looks))
        return polls(node_2={"status": {"rounds": [{"no": "round"}]}}) if len(looks) < LOOKS_COUNT else polls()

    await _watch(console, look, monkeypatch)
    assert console.moment is not None
    told = [event["text"] for event in console.recorder.events_after(0)]
    assert told[0] == "The console cannot see the network: KeyError."
    assert sum("cannot see" in text for text in told) == 1


async def _watch(console: LiveConsole, look: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the console look so often, without its pauses."""
    pauses = []
    really_sleep = asyncio.sleep

    async def sleep(delay_s: float) -> None:
        pauses.append(delay_s)
        await really_sleep(0)
        if len(pauses) >= LOOKS_COUNT:
            raise asyncio.CancelledError

    monkeypatch.setattr(NodePoller, "poll", look)
    monkeypatch.setattr("network.console.live.asyncio.sleep", sleep)
    with pytest.raises(asyncio.CancelledError):
        await console.run()


async def test_a_run_that_is_handed_on_does_not_say_where_its_network_lies(
    console: LiveConsole, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = console.cluster.folder
    (folder / "nodes" / "node-2" / "output.log").write_text(f"PermissionError: '{folder}/nodes/node-2/journal'\n")
    monkeypatch.setattr(Cluster, "is_running", lambda _self, name: name != "node-2")
    monkeypatch.setattr(Cluster, "start", lambda _self, _name, **_: None)
    monkeypatch.setattr("network.cluster.fetch_status", _nothing)
    with pytest.raises(BlockRobotError) as caught:
        await console.do({"do": "restart", "node": "node-2"})
    assert str(folder) in caught.value.detail
    text = console.export()
    assert "PermissionError: '(the network's folder)/nodes/node-2/journal'" in text
    assert str(folder) not in text


async def test_what_a_node_says_of_its_fault_is_handed_on_without_the_place_where_it_lies(console: LiveConsole) -> None:
    folder = console.cluster.folder
    console._update(polls())
    console._update(polls(node_3={"status": {"fault": f"The disk refuses {folder}/nodes/node-3/journal: it is full."}}))
    said = "The disk refuses (the network's folder)/nodes/node-3/journal: it is full."
    assert console.moment is not None
    assert console.moment["nodes"][2]["state"] == f"fault: {said}"
    assert f"node-3 has a fault: {said[:-1]}, final height 10." in console.export()
    assert str(folder) not in console.export()


async def _nothing(*_: Any) -> None:
    return None


async def test_times_of_a_recording_stand_in_order_though_the_machines_clock_is_set_back() -> None:
    wall_ms = iter((1_000, 1_500, 400, 500, 9_000))
    clock = ForwardClock(lambda: next(wall_ms))
    assert [clock.now_ms() for _ in range(5)] == [1_000, 1_500, 1_500, 1_600, 10_100]


async def test_a_folder_that_is_being_removed_is_left_as_it_was_known(console: LiveConsole) -> None:
    shutil.rmtree(console.cluster.folder)
    assert not console._is_another()
    console._begin_anew()
    assert len(to_builtins(console.facts())["nodes"]) == 4

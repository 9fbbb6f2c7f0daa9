"""What a watcher is told: how each node is, what changed, and for how long work has waited without finality."""

from __future__ import annotations

from typing import Any

import pytest
from rich.console import Console

from network.cli.cluster.status_watch import picture_answer, render
from network.cluster_monitor import STUCK_AFTER_S, NodeObservation, Observer, changes, state_of


def look(name: str = "node-1", *, faults: tuple[str, ...] = (), **status: Any) -> NodeObservation:
    said = {
        "ready": True,
        "height": 5,
        "finalized_height": 4,
        "round": 7,
        "epoch": 0,
        "leader": "node-2",
        "peers": ["node-2", "node-3"],
        "mempool": 0,
        "fault": "",
        "lockout": None,
    }
    return NodeObservation(name, running=True, paused=False, status=said | status, faults=faults)


def test_who_is_accused_by_others_is_told_and_its_own_word_does_not_count() -> None:
    rows = [{"name": "node-4", "state": "evidence", "height": None}]
    looks = [look("node-1", accused=rows), look("node-2", accused=[]), look("node-4", accused=rows)]
    picture = Observer(0.0).update(looks, 0.0)
    assert {row.name: row.accused_by for row in picture.rows} == {"node-1": (), "node-2": (), "node-4": ("node-1",)}
    assert "node-4 is accused of contradicting itself by node-1" in changes(None, picture)
    assert not any("accused" in line for line in changes(picture, picture))


@pytest.mark.parametrize(
    ("seen", "state"),
    [
        (look(), "signing"),
        (look(ready=False), "waiting"),
        (look(suspended_height=7), "suspended"),
        (look(suspended_height=None), "signing"),
        (look(ready=False, peers=[], problem={"code": "NODE_REMOVED", "detail": "It was removed."}), "removed"),
        (look(fault="The disk is full."), "fault: The disk is full."),
        (look(lockout={"reason": "asking", "until": "later"}), "locked out: asking"),
        (NodeObservation("node-1", running=True, paused=False, status=None), "no answer"),
        (NodeObservation("node-1", running=True, paused=True, status=None), "paused"),
        (NodeObservation("node-1", running=False, paused=False, status=None), "stopped"),
    ],
)
def test_a_nodes_state_is_said_in_a_few_words(seen: NodeObservation, state: str) -> None:
    assert state_of(seen) == state


def test_an_idle_network_ages_but_is_not_stuck_and_its_picture_is_ready_for_json() -> None:
    observer = Observer(100.0)
    observer.update([look()], 100.0)
    picture = observer.update([look()], 160.0)
    assert (picture.finality_age_s, picture.stuck_s, picture.longest_stuck_s) == (60.0, 0.0, 0.0)
    answer = picture_answer(Observer(1.0).update([look()], 2.0004), [])
    assert answer.at_s == 1.0
    assert [(node.name, node.peers) for node in answer.nodes] == [("node-1", 2)]


def test_work_without_finality_is_counted_until_any_node_grows() -> None:
    observer = Observer(0.0)
    observer.update([look()], 0.0)
    observer.update([look(mempool=3)], 1.0)
    stuck = observer.update([look(mempool=3)], 4.0)
    assert (stuck.stuck_s, stuck.longest_stuck_s, stuck.finality_age_s) == (3.0, 3.0, 4.0)
    again = observer.update([look(mempool=3, finalized_height=5)], 5.0)
    assert (again.stuck_s, again.longest_stuck_s, again.finality_age_s) == (0.0, 3.0, 0.0)
    observer = Observer(0.0)
    observer.update([look("node-1", finalized_height=9), look("node-2", finalized_height=3)], 0.0)
    gone = NodeObservation("node-1", running=False, paused=False, status=None)
    picture = observer.update([gone, look("node-2", finalized_height=4, mempool=1)], 2.0)
    assert (picture.finalized_height, picture.finality_age_s) == (9, 2.0)


def test_changes_alone_are_told_and_being_stuck_once() -> None:
    observer = Observer(0.0)
    first = observer.update([look()], 0.0)
    assert changes(None, first) == ["node-1 is signing, final height 4"]
    second = observer.update([look(height=8, finalized_height=7, round=11)], 1.0)
    assert changes(first, second) == []
    third = observer.update([look(epoch=1, peers=["node-2"], faults=("-> node-3: cut",), finalized_height=7)], 2.0)
    assert changes(second, third) == ["node-1 faults: -> node-3: cut", "node-1 is in epoch 1", "node-1 has 1 peers"]
    fourth = observer.update([NodeObservation("node-1", running=False, paused=False, status=None)], 3.0)
    assert changes(third, fourth) == ["node-1 is stopped", "node-1 faults: none"]
    observer = Observer(0.0)
    before, told = None, []
    for second in range(8):
        height = 4 if second < 5 else 5
        picture = observer.update([look(mempool=1, finalized_height=height)], float(second))
        told.append(changes(before, picture))
        before = picture
    assert STUCK_AFTER_S == 2.0
    assert told[2] == ["nothing has become final for 2.0 s, and work waits"]
    assert told[5] == ["final again at height 5, after 4.0 s"]
    assert told[1] == told[3] == told[4] == told[6] == []


def test_the_table_shows_faults_and_the_time_without_finality() -> None:
    observer = Observer(0.0)
    observer.update([look(mempool=1)], 0.0)
    looks = [
        look(mempool=1, faults=("clock +1h",)),
        NodeObservation("node-2", running=False, paused=False, status=None),
    ]
    picture = observer.update(looks, 3.5)
    console = Console(width=160, record=True, force_terminal=False)
    with console.capture() as capture:
        console.print(render(picture, "network"))
    shown = capture.get()
    for words in ("clock +1h", "stopped", "signing", "Nothing has become final for 3.5 s", "q quits"):
        assert words in shown

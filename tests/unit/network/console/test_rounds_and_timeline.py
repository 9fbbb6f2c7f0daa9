"""Rounds are joined from what every node says of itself; what is new between two moments is said once."""

from __future__ import annotations

from typing import Any

import msgspec

from network.console.rounds import RoundBook
from network.console.snapshots import SnapshotBuilder
from network.console.timeline import GAVE_UP_AWAITED_MS, REPEATED_AFTER_MS, Event, Timeline, leader_of
from tests.unit.network.console.polls import polls, said, stopped

WALL_MS = 1_700_000_000_000
QUORUM = 3


class _Watcher:
    """A chronicle fed as the console feeds it, a second a look."""

    def __init__(self) -> None:
        self.maker, self.book, self.timeline = SnapshotBuilder(0.0), RoundBook(QUORUM), Timeline()
        self.seconds = 0

    def look(self, after_s: int = 1, **changes: Any) -> list[Event]:
        self.seconds += after_s
        wall_ms, seen = WALL_MS + 1_000 * self.seconds, polls(**changes)
        moment = self.maker.update(seen, float(self.seconds), wall_ms)
        return self.timeline.update(moment, self.book.update(seen, wall_ms))


def _texts(events: list[Event]) -> list[str]:
    return [f"{event['kind']}: {event['text']}" for event in events]


def _all_say(*rounds: dict[str, Any], names: tuple[str, ...] = ("node_1", "node_3", "node_4")) -> dict[str, Any]:
    return {name: {"status": {"rounds": list(rounds)}} for name in names}


def test_words_of_all_nodes_make_one_round() -> None:
    book = RoundBook(QUORUM)
    book.update(polls(node_1={"status": {"rounds": [said(5, "proposed", "voted")]}}), WALL_MS)
    book.update(polls(**_all_say(said(5, "voted"), names=("node_2", "node_3"))), WALL_MS + 500)
    assert msgspec.to_builtins(book.last(10)) == [
        {
            "epoch": 0,
            "round": 5,
            "at_ms": WALL_MS,
            "leader": "node-1",
            "proposed": ["node-1"],
            "voted": ["node-1", "node-2", "node-3"],
            "gave_up": [],
            "outcome": "won",
        }
    ]


def test_a_round_that_a_quorum_gave_up_is_lost_and_one_of_which_little_is_known_is_open() -> None:
    book = RoundBook(QUORUM)
    book.update(polls(**_all_say(said(5, "gave-up"), said(6, "voted")), node_2=stopped()), WALL_MS)
    book.update(polls(node_2={"status": {"rounds": [said(7, "voted")]}}), WALL_MS)
    assert [(row.round, row.outcome) for row in book.last(10)] == [(5, "lost"), (6, "won"), (7, "open")]


def test_what_a_quorum_is_goes_by_each_rounds_own_epoch() -> None:
    book = RoundBook(QUORUM, ("node-1", "node-2", "node-3", "node-4"))
    words = {"rounds": [said(40, "voted")]}
    book.update(polls(node_1={"status": words}, node_2={"status": words}, node_3={"status": words}), WALL_MS)
    now_of_one = {"epoch": 1, "quorum": 2, "producers": ["node-1", "node-2"], "rounds": [said(1, "voted", epoch=1)]}
    book.update(polls(node_1={"status": now_of_one}, node_2={"status": now_of_one}), WALL_MS)
    book.update(polls(node_3={"status": {"rounds": [said(41, "gave-up")]}}), WALL_MS)
    assert [(row.epoch, row.round, row.outcome) for row in book.last(10)] == [
        (0, 40, "won"),
        (0, 41, "open"),
        (1, 1, "won"),
    ]
    assert (book.quorum, sorted(book.producers)) == (2, ["node-1", "node-2"])


def test_only_what_is_new_is_handed_on_and_old_rounds_are_dropped_and_never_come_back() -> None:
    book = RoundBook(QUORUM, kept_count=2)
    rounds = [said(number, "voted") for number in (1, 2, 3)]
    assert [entry.number for entry in book.update(polls(**_all_say(*rounds)), WALL_MS)] == [1, 2, 3]
    assert book.dropped_count == 1
    assert book.update(polls(**_all_say(*rounds)), WALL_MS) == []
    assert [row.round for row in book.last(10)] == [2, 3]


def test_rounds_of_epochs_stand_in_order() -> None:
    book = RoundBook(QUORUM)
    book.update(polls(**_all_say(said(1, "voted", epoch=1), said(40, "voted"))), WALL_MS)
    assert [(row.epoch, row.round) for row in book.last(10)] == [(0, 40), (1, 1)]


def test_the_first_look_says_how_it_stands_and_the_same_again_is_no_news() -> None:
    watcher = _Watcher()
    assert _texts(watcher.look()) == [
        "node: The recording begins: node-1 signing, node-2 signing, node-3 signing, node-4 signing."
    ]
    assert watcher.look() == []


def test_a_node_that_stops_and_comes_back_is_told_once_each() -> None:
    watcher = _Watcher()
    watcher.look()
    assert _texts(watcher.look(node_2=stopped())) == ["node: node-2 is stopped."]
    assert watcher.look(node_2=stopped()) == []
    back = watcher.look()
    assert _texts(back) == ["node: node-2 is signing, final height 10."]
    assert (back[0]["tone"], back[0]["nodes"]) == ("good", ["node-2"])


def test_a_node_that_does_not_answer_or_has_a_fault_is_told_in_a_sentence() -> None:
    watcher = _Watcher()
    watcher.look()
    assert _texts(watcher.look(node_2={"status": None})) == ["node: node-2 does not answer."]
    faulty = watcher.look(node_2={"status": {"fault": "DISK_FULL"}})
    assert _texts(faulty)[0].startswith("node: node-2 has a fault: DISK_FULL")


def test_faults_are_told_when_they_come_and_when_they_go_whoever_switched_them() -> None:
    watcher = _Watcher()
    watcher.look()
    changed = watcher.look(node_3={"faults": ("clock +1h", "-> node-1: cut")})
    assert _texts(changed) == ["fault: On at node-3: clock +1h; -> node-1: cut."]
    assert _texts(watcher.look(node_3={"faults": ("clock +1h",)})) == ["fault: Off at node-3: -> node-1: cut."]


def test_a_lost_round_is_told_with_its_leader_and_who_gave_it_up() -> None:
    watcher = _Watcher()
    watcher.look()
    events = watcher.look(node_2=stopped(), **_all_say(said(9, "gave-up", leader="node-2")))
    assert "timeout: Round 9 (leader node-2) was given up by node-1, node-3, node-4." in _texts(events)


def test_a_round_that_few_gave_up_is_told_some_time_after_later_rounds_are_under_way() -> None:
    watcher = _Watcher()
    watcher.look()
    assert watcher.look(node_1={"status": {"rounds": [said(9, "gave-up")]}}) == []
    passed = {"node_1": {"status": {"rounds": [said(9, "gave-up"), said(10, "voted")]}}}
    assert watcher.look(**passed) == []
    assert watcher.look(GAVE_UP_AWAITED_MS // 1_000 - 1, **passed) == []
    events = watcher.look(**passed)
    assert _texts(events) == ["timeout: Round 9 (leader node-1) was given up by node-1."]
    assert watcher.look(**passed) == []


def test_who_gave_a_round_up_and_was_asked_too_early_or_answered_too_late_is_told_too() -> None:
    watcher = _Watcher()
    watcher.look()
    gone = {"status": {"rounds": [said(9, "gave-up", leader="node-2"), said(10, "voted", leader="node-3")]}}
    early = {"status": {"rounds": []}}
    assert "timeout" not in {event["kind"] for event in watcher.look(node_2=stopped(), node_3=gone, node_1=early)}
    events = watcher.look(node_2=stopped(), node_1=gone, node_3=gone, node_4=gone)
    assert "timeout: Round 9 (leader node-2) was given up by node-1, node-3, node-4." in _texts(events)


def test_a_round_that_is_told_late_stands_in_order_among_the_leaders_next_ones() -> None:
    watcher = _Watcher()
    watcher.look()
    few = {"node_1": {"status": {"rounds": [said(13, "gave-up", leader="node-2"), said(14, "voted")]}}}
    watcher.look(**_all_say(said(9, "gave-up", leader="node-2")))
    watcher.look(**few)
    watcher.look(**_all_say(said(17, "gave-up", leader="node-2")))
    later = [text for _ in range(REPEATED_AFTER_MS // 1_000) for text in _texts(watcher.look())]
    assert later == ["timeout: 2 more of node-2's rounds were given up (13 to 17)."]


def test_the_next_lost_rounds_of_a_dead_leader_are_told_together() -> None:
    watcher = _Watcher()
    watcher.look()
    rounds = [said(number, "gave-up", leader="node-2") for number in (9, 13, 17)]
    told = [_texts(watcher.look(**_all_say(*rounds[:count]))) for count in (1, 2, 3)]
    assert [len(texts) for texts in told] == [1, 0, 0]
    later = watcher.look(after_s=REPEATED_AFTER_MS // 1_000, **_all_say(*rounds))
    assert _texts(later) == ["timeout: 2 more of node-2's rounds were given up (13 to 17)."]
    assert watcher.look(after_s=REPEATED_AFTER_MS // 1_000, **_all_say(*rounds)) == []


def test_suspension_epochs_connections_and_leaders_are_told() -> None:
    watcher = _Watcher()
    watcher.look()
    status = {"suspended_height": 10, "epoch": 1, "peers": ["node-1"], "leader": "node-3", "round": 13}
    kinds = {event["kind"]: event["text"] for event in watcher.look(node_4={"status": status})}
    assert kinds["suspension"] == "node-4 is suspended since height 10 and leads nothing."
    assert kinds["epoch"] == "node-4 is in epoch 1."
    assert kinds["link"] == "node-4 is connected with 1 others."
    assert kinds["leader"] == "node-3 leads round 13."
    assert any(event["text"] == "node-4 is no longer suspended." for event in watcher.look())


def test_a_stall_of_finality_is_told_when_it_begins_and_when_it_ends() -> None:
    watcher = _Watcher()
    waiting = {"node_1": {"status": {"mempool": 2}}}
    watcher.look()
    told = [text for _ in range(5) for text in _texts(watcher.look(**waiting))]
    assert told == ["finality: Nothing became final for 2.0 s, and work waits."]
    assert _texts(watcher.look(node_1={"status": {"finalized_height": 12}}))[-1].startswith(
        "finality: Final again at height 12, after"
    )


def test_where_nobody_answers_any_more_no_work_is_said_to_be_done() -> None:
    watcher = _Watcher()
    watcher.look(node_1={"status": {"mempool": 3}})
    watcher.look(3, node_1={"status": {"mempool": 3}})
    told = watcher.look(**dict.fromkeys(("node_1", "node_2", "node_3", "node_4"), stopped()))
    (ended,) = (event for event in told if event["kind"] == "finality")
    assert ended["text"] == "After 4.0 s without anything final no node answers: whether work waits, nobody says."
    assert ended["tone"] == "bad"


def test_who_leads_is_what_the_node_in_the_highest_round_says() -> None:
    seen = polls(node_2={"status": {"leader": "node-4", "round": 20}}, node_3=stopped())
    assert leader_of(SnapshotBuilder(0.0).update(seen, 1.0, WALL_MS)) == ("node-4", 20)
    none = polls(node_1=stopped(), node_2=stopped(), node_3=stopped(), node_4=stopped())
    assert leader_of(SnapshotBuilder(0.0).update(none, 1.0, WALL_MS)) == (None, -1)

"""A recording stays within its limit, keeps what is newest, and says what it dropped."""

from __future__ import annotations

import itertools
import json
from typing import Any

from network.console.console_documents import NetworkFacts, NodeFacts
from network.console.recorder import NETWORKS_MAX_COUNT, Recorder
from network.console.timeline import make_event


def _moment(number: int) -> dict[str, Any]:
    return {"at_ms": 1_000 * number, "final": number, "nodes": [], "links": [], "padding": "x" * 50}


def _kept(recorder: Recorder) -> list[int]:
    return [moment["final"] for moment in json.loads(recorder.moments_json())]


def test_a_moment_in_which_only_the_time_went_on_is_not_kept_twice() -> None:
    recorder = Recorder()
    recorder.add(_moment(1), [])
    recorder.add({**_moment(1), "at_ms": 1_500}, [])
    recorder.add(_moment(2), [])
    assert _kept(recorder) == [1, 2]
    assert recorder.moments_dropped_count == 0


def test_a_run_reaches_to_the_last_look_though_nothing_had_changed_by_then() -> None:
    recorder = Recorder()
    recorder.add(_moment(1), [])
    for at_ms in (2_000, 24_000):
        recorder.add({**_moment(1), "at_ms": at_ms}, [])
    first, last = json.loads(recorder.moments_json())
    assert (first["at_ms"], last) == (1_000, {**first, "at_ms": 24_000})
    assert recorder.moments_count == 1, "nothing more is kept for it"
    recorder.add({**_moment(2), "at_ms": 25_000}, [])
    assert _kept(recorder) == [1, 2]


def test_what_was_at_a_time_is_told_also_of_a_run_that_grew_coarser() -> None:
    recorder = Recorder(moments_max_bytes=4_000)
    assert recorder.moment_at(5) is None
    for number in range(1_000):
        recorder.add(_moment(number), [])
    kept = _kept(recorder)
    for at_ms in (-1, 0, 1_500, 400_400, 998_999, 999_000, 5_000_000):
        expected = max((number for number in kept if 1_000 * number <= at_ms), default=kept[0])
        moment = recorder.moment_at(at_ms)
        assert moment is not None
        assert moment["final"] == expected


def test_memory_is_bounded_and_the_whole_run_stays_the_older_the_coarser() -> None:
    recorder = Recorder(moments_max_bytes=4_000)
    for number in range(1_000):
        recorder.add(_moment(number), [])
        assert recorder.size_bytes <= 4_000
    kept = _kept(recorder)
    assert kept == sorted(kept)
    assert (kept[0], kept[-1]) == (0, 999)
    assert recorder.size_bytes == sum(len(json.dumps(_moment(n), separators=(",", ":"))) for n in kept)
    assert recorder.moments_dropped_count == 1_000 - len(kept)
    steps = [second - first for first, second in itertools.pairwise(kept)]
    assert max(steps[: len(steps) // 2]) > max(steps[-5:])


def test_what_was_dropped_is_said() -> None:
    recorder = Recorder(moments_max_bytes=1_000, events_max_count=2)
    assert recorder.dropped().words == ""
    for number in range(100):
        recorder.add(_moment(number), [make_event(number, "node", "news")])
    dropped = recorder.dropped(rounds_count=7)
    assert (dropped.events, dropped.rounds) == (98, 7)
    assert dropped.moments == recorder.moments_dropped_count > 0
    assert dropped.words.startswith("To stay within its limit the recording dropped ")
    assert "98 events, 7 rounds" in dropped.words


def test_events_are_numbered_and_told_from_a_number_on() -> None:
    recorder = Recorder()
    recorder.tell(make_event(1, "node", "first"))
    recorder.tell(make_event(2, "leader", "second"))
    recorder.tell(make_event(3, "fault", "third"))
    assert [event["text"] for event in recorder.events_after(0)] == ["first", "second", "third"]
    assert [event["text"] for event in recorder.events_after(2)] == ["third"]
    assert recorder.events_after(3) == []
    assert recorder.last_event_number == 3


def test_who_leads_drives_no_fault_out_of_the_time_line() -> None:
    recorder = Recorder(events_max_count=5, routine_max_count=2)
    recorder.tell(make_event(0, "fault", "the fault"))
    for number in range(50):
        recorder.tell(make_event(number, "leader", f"leader {number}"))
    assert [event["text"] for event in recorder.events_after(0)] == ["the fault", "leader 48", "leader 49"]
    assert recorder.events_dropped_count == 48


def test_only_the_newest_states_are_kept_of_what_is_too_much() -> None:
    recorder = Recorder(moments_max_bytes=10)
    for number in range(5):
        recorder.add(_moment(number), [])
    assert _kept(recorder)[-1] == 4
    assert recorder.moments_count <= 3
    recorder = Recorder()
    for number in range(NETWORKS_MAX_COUNT + 5):
        recorder.note_network(number, _network(f"node-{number}"))
    assert len(recorder.networks()) == NETWORKS_MAX_COUNT
    assert recorder.network_at(0) == _network("node-5")


def _network(*names: str) -> NetworkFacts:
    return NetworkFacts("ward", 3, [NodeFacts(name, "ward", True, True, True) for name in names])


def test_each_time_has_the_nodes_of_its_time_also_those_that_have_gone() -> None:
    recorder = Recorder()
    assert recorder.network_at(0) is None
    for at_ms, names in ((1_000, "ab"), (2_000, "ab"), (3_000, "abc"), (4_000, "bc")):
        recorder.note_network(at_ms, _network(*names))
    assert [known.at_ms for known in recorder.networks()] == [1_000, 3_000, 4_000]
    for at_ms, names in ((0, "ab"), (2_999, "ab"), (3_000, "abc"), (9_000, "bc")):
        assert recorder.network_at(at_ms) == _network(*names)
    assert recorder.names() == ["a", "b", "c"]

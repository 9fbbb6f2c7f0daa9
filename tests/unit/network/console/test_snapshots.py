"""A moment holds what the nodes said, and rates made of their counts."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest

from network.console.node_polling import METRICS_MAX_BYTES, _read_whole, _Span, parse_counts
from network.console.snapshots import ConsoleSnapshot, SnapshotBuilder, link_state
from node.p2p.link_faults import SOUND, LinkFault
from tests.unit.network.console.polls import poll, polls, stopped

WALL_MS = 1_700_000_000_000
Counts = dict[tuple[str, str, str], tuple[int, int]]


def _link(moment: ConsoleSnapshot, source: str, target: str) -> dict[str, object] | None:
    return next((link for link in moment["links"] if (link["from"], link["to"]) == (source, target)), None)


def test_a_quiet_network_has_no_links_to_tell_of() -> None:
    moment = SnapshotBuilder(0.0).update(polls(), 1.0, WALL_MS)
    assert moment["links"] == []
    assert (moment["final"], moment["stuck_since_ms"]) == (10, None)
    assert moment["nodes"][0] == {
        "name": "node-1",
        "state": "signing",
        "height": 11,
        "final": 10,
        "lag": 0,
        "round": 12,
        "epoch": 0,
        "leader": "node-1",
        "peers": 3,
        "waiting": 0,
    }


def test_rates_are_counts_by_the_seconds_between_two_looks_and_a_new_start_counts_from_nothing() -> None:
    maker = SnapshotBuilder(0.0)
    first: Counts = {("node-2", "sent", "vote"): (10, 1_000)}
    heard: Counts = {("node-1", "received", "vote"): (10, 1_000)}
    maker.update(polls(node_1={"counts": first}, node_2={"counts": heard}), 1.0, WALL_MS)
    first = {("node-2", "sent", "vote"): (30, 3_000), ("node-2", "sent", "proposal"): (2, 9_000)}
    heard = {("node-1", "received", "vote"): (20, 2_000), ("node-1", "received", "proposal"): (2, 9_000)}
    moment = maker.update(polls(node_1={"counts": first}, node_2={"counts": heard}), 3.0, WALL_MS + 2_000)
    assert _link(moment, "node-1", "node-2") == {
        "from": "node-1",
        "to": "node-2",
        "state": "up",
        "sent": 11.0,
        "arrived": 6.0,
        "bytes": 5_000,
        "kinds": {"proposal": 1.0, "vote": 5.0},
    }
    assert _link(moment, "node-2", "node-1") is None
    maker = SnapshotBuilder(0.0)
    maker.update(polls(node_1={"counts": {("node-2", "sent", "vote"): (500, 1)}}), 1.0, WALL_MS)
    moment = maker.update(polls(node_1={"counts": {("node-2", "sent", "vote"): (4, 1)}}), 3.0, WALL_MS)
    link = _link(moment, "node-1", "node-2")
    assert link is not None
    assert link["sent"] == 2.0


def test_a_link_that_is_cut_or_has_a_paused_end_carries_nothing() -> None:
    maker = SnapshotBuilder(0.0)
    cut = {"links": {"node-2": {"cut": True}}}
    maker.update(polls(node_1={"counts": {("node-2", "sent", "vote"): (0, 0)}, "switched": cut}), 1.0, WALL_MS)
    moment = maker.update(polls(node_1={"counts": {("node-2", "sent", "vote"): (8, 1)}, "switched": cut}), 2.0, WALL_MS)
    link = _link(moment, "node-1", "node-2")
    assert link is not None
    assert (link["state"], link["words"], link["sent"], link["arrived"]) == ("cut", "cut", 8.0, 0)
    assert link_state(poll("node-1", paused=True), poll("node-2"), SOUND) == "still"
    assert link_state(poll("node-1", status={"peers": ["node-3"]}), poll("node-2"), SOUND) == "down"
    assert link_state(poll("node-1", status=None), poll("node-2"), SOUND) == "up"


def test_a_node_that_is_down_says_nothing_and_its_links_are_down_both_ways() -> None:
    moment = SnapshotBuilder(0.0).update(polls(node_2=stopped()), 1.0, WALL_MS)
    assert moment["nodes"][1] == {"name": "node-2", "state": "stopped"}
    for other in ("node-1", "node-3", "node-4"):
        for link in (_link(moment, "node-2", other), _link(moment, other, "node-2")):
            assert link is not None
            assert link["state"] == "down"


@pytest.mark.parametrize(
    ("fault", "state"),
    [
        (SOUND, "up"),
        (LinkFault(cut=True), "cut"),
        (LinkFault(loss=0.1, delay_ms=5), "lossy"),
        (LinkFault(delay_ms=5, bandwidth_bytes_per_s=5), "slow"),
        (LinkFault(jitter_ms=5), "slow"),
        (LinkFault(bandwidth_bytes_per_s=5), "narrow"),
    ],
)
def test_a_links_state_is_named_by_the_worst_that_is_wrong(fault: LinkFault, state: str) -> None:
    assert link_state(poll("node-1"), poll("node-2"), fault) == state


def test_clocks_disks_lies_lag_and_suspension_stand_at_the_node() -> None:
    changes = {
        "switched": {"clock_offset_ms": 3_600_000, "disk": ["journal"]},
        "behaviour": "equivocate",
        "clock_off_ms": 3_600_049,
        "faults": ("byzantine: equivocate", "clock +1h", "journal disk full"),
        "status": {"finalized_height": 7, "suspended_height": 5},
    }
    node = SnapshotBuilder(0.0).update(polls(node_4=changes), 1.0, WALL_MS)["nodes"][3]
    assert (node["clock_set_ms"], node["clock_off_ms"], node["disks"]) == (3_600_000, 3_600_000, ["journal"])
    assert (node["behaviour"], node["lag"], node["suspended"]) == ("equivocate", 3, 5)
    assert node["faults"] == ["byzantine: equivocate", "clock +1h", "journal disk full"]


def test_work_that_waits_while_nothing_becomes_final_makes_it_stuck() -> None:
    maker = SnapshotBuilder(0.0)
    waiting = {"node_1": {"status": {"mempool": 3}}}
    assert maker.update(polls(**waiting), 1.0, WALL_MS)["stuck_since_ms"] is None
    assert maker.update(polls(**waiting), 2.5, WALL_MS + 1_500)["stuck_since_ms"] is None
    assert maker.update(polls(**waiting), 4.0, WALL_MS + 3_000)["stuck_since_ms"] == WALL_MS
    assert maker.update(polls(), 4.5, WALL_MS + 3_500)["stuck_since_ms"] is None


def test_counts_are_read_from_a_nodes_metrics_and_nothing_else_is() -> None:
    text = "\n".join(
        (
            "# TYPE blockrobot_peer_frames_total counter",
            'blockrobot_peer_frames_total{peer="node-2",direction="sent",kind="vote"} 12',
            'blockrobot_peer_bytes_total{peer="node-2",direction="sent",kind="vote"} 1400',
            'blockrobot_peer_frames_total{peer="x\\"y",direction="sent",kind="vote"} 9',
            "blockrobot_round 7.0",
        )
    )
    assert parse_counts(text) == {("node-2", "sent", "vote"): (12, 1_400)}
    assert parse_counts("") == {}


async def test_metrics_that_come_in_pieces_are_read_whole_and_endless_ones_not_at_all() -> None:
    async def body(*pieces: bytes) -> AsyncIterator[bytes]:
        for piece in pieces:
            yield piece

    assert await _read_whole(body(b"a 1", b"2\nb", b" 3\n")) == b"a 12\nb 3\n"
    assert await _read_whole(body(*[b"x" * (METRICS_MAX_BYTES // 4)] * 5)) == b""


@pytest.mark.parametrize(("said_ms", "off_ms"), [(1_000, 0), (1_400, 0), (2_000, 0), (900, -100), (2_250, 250)])
def test_a_clock_is_off_only_by_what_the_time_of_asking_does_not_explain(said_ms: int, off_ms: int) -> None:
    assert _Span(1_000, 2_000).off_ms(said_ms) == off_ms

"""Frames between nodes are counted by peer, direction and kind."""

from __future__ import annotations

from node.p2p.traffic import Traffic
from node.p2p.wire import FrameKind


def test_each_frame_is_counted_where_it_belongs_and_nothing_said_is_no_line() -> None:
    traffic = Traffic()
    traffic.note("node-2", "sent", FrameKind.VOTE, 120)
    traffic.note("node-2", "sent", FrameKind.VOTE, 130)
    traffic.note("node-2", "received", FrameKind.VOTE, 120)
    traffic.note("node-3", "sent", FrameKind.PROPOSAL, 900)
    lines = traffic.render().decode().splitlines()
    assert 'blockrobot_peer_frames_total{peer="node-2",direction="sent",kind="vote"} 2' in lines
    assert 'blockrobot_peer_bytes_total{peer="node-2",direction="sent",kind="vote"} 250' in lines
    assert 'blockrobot_peer_frames_total{peer="node-2",direction="received",kind="vote"} 1' in lines
    assert 'blockrobot_peer_frames_total{peer="node-3",direction="sent",kind="proposal"} 1' in lines
    assert lines.count("# TYPE blockrobot_peer_frames_total counter") == 1
    traffic.note('a"\n', "sent", 250, 5)
    assert 'peer="a\\"\\n",direction="sent",kind="unknown"} 1' in traffic.render().decode()


def test_nothing_said_is_no_line_of_figures() -> None:
    assert all(line.startswith("#") for line in Traffic().render().decode().splitlines())

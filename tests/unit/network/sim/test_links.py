"""Simulated links: a peer that was cut off stays away for as long as a real node would not hear it."""

from __future__ import annotations

import random
from typing import Any

import pytest

from consensus.errors import BlockRobotError
from network.sim.world.links import REDIAL_MS, SimNetwork, Wires
from network.sim.world.virtual_time import Owner, SimLoop
from node.limits.peer_bans import BAN_FIRST_MS, BAN_MAX_MS

LIE = BlockRobotError("SIGNATURE_INVALID")
SOON_MS = 2 * REDIAL_MS


class Handler:
    """Notes when peers come and go."""

    def __init__(self, loop: SimLoop) -> None:
        self._loop = loop
        self.seen: list[tuple[str, str, float]] = []

    def finalized_height(self) -> int:
        return 0

    def peer_connected(self, peer: str, _height: int) -> None:
        self.seen.append(("came", peer, self._loop.now_ms))

    def peer_disconnected(self, peer: str) -> None:
        self.seen.append(("went", peer, self._loop.now_ms))


class Pair:
    """Two connected ends, `a` and `b`, each in its first life."""

    def __init__(self) -> None:
        self.loop, self.cuts = SimLoop(1), list[tuple[str, str, str]]()
        self.wires = Wires(self.loop, random.Random(1), lambda *_: None, lambda *cut: self.cuts.append(cut))
        self.handlers: dict[str, Handler] = {}
        self.a, self.b = self.open("a"), self.open("b")
        self.run(SOON_MS)

    def open(self, name: str) -> SimNetwork:
        handler: Any = Handler(self.loop)
        self.handlers[name] = handler
        end = SimNetwork(self.wires, Owner(name), name, handler)
        self.wires.attach(end)
        return end

    def run(self, for_ms: float) -> None:
        self.loop.run_until(lambda: False, self.loop.time() + for_ms / 1000)


def test_a_peer_that_lied_is_away_on_both_sides_for_the_whole_pause() -> None:
    pair = Pair()
    pair.a.cut_off("b", LIE)
    pair.run(BAN_FIRST_MS)
    assert pair.a.connected == pair.b.connected == []
    pair.run(SOON_MS)
    assert (pair.a.connected, pair.b.connected) == (["b"], ["a"])
    assert pair.cuts == [("a", "b", "SIGNATURE_INVALID")]


def test_each_pause_is_twice_as_long_up_to_five_minutes() -> None:
    pair, pauses_ms = Pair(), []
    for _ in range(10):
        at_ms = pair.loop.now_ms
        pair.a.cut_off("b", LIE)
        pair.run(BAN_MAX_MS + SOON_MS)
        came_ms = next(when for what, _, when in pair.handlers["a"].seen if what == "came" and when > at_ms)
        pauses_ms.append(came_ms - at_ms)
    expected = [min(BAN_FIRST_MS << number, BAN_MAX_MS) for number in range(10)]
    for pause_ms, least_ms in zip(pauses_ms, expected, strict=True):
        assert least_ms - 1 <= pause_ms <= least_ms + SOON_MS


def test_a_second_lie_during_a_pause_and_a_lie_of_who_is_not_there_count_for_nothing() -> None:
    pair = Pair()
    pair.a.cut_off("b", LIE)
    pair.a.cut_off("b", LIE)
    pair.run(0)
    pair.a.cut_off("b", LIE)
    pair.a.cut_off("c", LIE)
    pair.run(BAN_FIRST_MS + SOON_MS)
    assert pair.a.connected == ["b"]


def test_neither_new_links_nor_another_pause_but_a_new_life_ends_a_pause() -> None:
    pair = Pair()
    pair.a.cut_off("b", LIE)
    pair.wires.reconnect_all()
    pair.run(BAN_FIRST_MS - 1)
    assert pair.a.connected == []
    pair = Pair()
    pair.a.cut_off("b", LIE)
    pair.wires.detach("a")
    again = pair.open("a")
    pair.run(SOON_MS)
    assert again.connected == ["b"]


@pytest.mark.parametrize("is_malformed", [True, False])
def test_a_malformed_frame_begins_a_pause_too(*, is_malformed: bool) -> None:
    pair = Pair()

    def take(*_: object) -> None:
        if is_malformed:
            raise BlockRobotError("ENCODING_INVALID")

    vars(pair.handlers["a"])["peer_frame"] = take
    pair.a.receive("b", 1, b"")  # type: ignore[arg-type]
    pair.run(SOON_MS)
    assert (pair.a.connected == []) is is_malformed

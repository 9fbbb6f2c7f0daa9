"""A node tells how long nothing has become final, and calls it late only if it is: an idle chain is at rest, not stuck."""

from __future__ import annotations

import pytest

from consensus.chain.epoch_settings import ChainSettings
from node.consensus.stall_detector import StallDetector
from node.storage.ledger_store import Position


class Hand:
    """A stopwatch that is moved by hand, in front of a watch of a chain with these settings."""

    def __init__(self, **settings: int | str) -> None:
        self.now_s = 100.0
        chosen = ChainSettings(**settings)  # type: ignore[arg-type]
        self.error_ms, self.catches_up = 0, False
        self.watch = StallDetector(
            lambda: self.now_s, lambda: chosen, lambda: self.time_ms + self.error_ms, lambda: self.catches_up
        )

    @property
    def time_ms(self) -> int:
        return round(self.now_s * 1000)

    def final(self, lag_ms: int = 0) -> None:
        self.watch.note_final([], None, Position(1, b"", b"", self.time_ms - lag_ms))

    def after(self, seconds: float, waiting: int | None = None) -> dict[str, object]:
        self.now_s += seconds
        if waiting is not None:
            self.watch.look(waiting)
        return self.watch.describe()


def test_an_idle_chain_is_late_only_when_its_empty_blocks_stay_away() -> None:
    hand = Hand(heartbeat_ms=30_000)
    assert hand.after(34.0) == {"age_s": 34.0, "waiting_s": 0.0, "late": False, "clock_error_s": 0.0}
    assert hand.after(2.0) == {"age_s": 36.0, "waiting_s": 0.0, "late": True, "clock_error_s": 0.0}
    hand.final()
    assert hand.after(0.5) == {"age_s": 0.5, "waiting_s": 0.0, "late": False, "clock_error_s": 0.0}


def test_work_that_waits_makes_it_late_much_sooner_but_not_for_having_come_to_an_idle_chain() -> None:
    hand = Hand(heartbeat_ms=30_000)
    assert not hand.after(20.0, waiting=1)["late"]
    assert hand.after(6.0, waiting=2) == {"age_s": 26.0, "waiting_s": 6.0, "late": True, "clock_error_s": 0.0}
    assert hand.after(1.0, waiting=0) == {"age_s": 27.0, "waiting_s": 0.0, "late": False, "clock_error_s": 0.0}
    hand.after(0.0, waiting=1)
    hand.final()
    assert hand.after(4.0)["waiting_s"] == 0.0, "what is left counts from the next look on"


@pytest.mark.parametrize(
    ("settings", "seconds", "is_late"),
    [
        ({"base_timeout_ms": 10_000, "timeout_cap_ms": 20_000}, 59.0, False),
        ({"base_timeout_ms": 10_000, "timeout_cap_ms": 20_000}, 61.0, True),
        ({"production": "manual"}, 10_000.0, False),
    ],
)
def test_waiting_is_measured_by_the_chains_own_timeouts(
    settings: dict[str, int | str], seconds: float, is_late: bool
) -> None:
    hand = Hand(**settings)
    hand.after(0.0, waiting=1)
    assert hand.after(seconds)["late"] is is_late


def test_a_chain_with_an_interval_is_late_by_it() -> None:
    hand = Hand(production="interval:1000")
    assert not hand.after(5.9)["late"]
    assert hand.after(0.2)["late"]


@pytest.mark.parametrize(("error_ms", "said_s"), [(600_000, 600.2), (-600_000, -599.8), (8_000, 0.0), (-4_000, 0.0)])
def test_a_wrong_clock_is_told_by_the_time_of_new_blocks(error_ms: int, said_s: float) -> None:
    hand = Hand()
    hand.error_ms = error_ms
    for _ in range(2):
        hand.after(5.0)
        hand.final(200)
    assert hand.after(0.0)["clock_error_s"] == 0.0, "two blocks are too few"
    hand.final(200)
    assert hand.after(1.0)["clock_error_s"] == said_s
    assert hand.after(100.0)["clock_error_s"] == 0.0, "without new blocks nothing is known of the clock"


def test_a_block_of_a_slow_producer_or_an_idle_chain_says_nothing_of_the_clock() -> None:
    hand = Hand(heartbeat_ms=30_000)
    for lag_ms in (90_000, 30_200, 90_000, 90_000):
        hand.after(30.0)
        hand.final(lag_ms)
        assert hand.after(0.0)["clock_error_s"] == 0.0


def test_old_blocks_say_nothing_of_the_clock_of_a_node_that_catches_up() -> None:
    hand = Hand()
    hand.catches_up = True
    for lag_ms in (3_600_000, 3_500_000, 3_400_000):
        hand.after(0.1)
        hand.final(lag_ms)
        assert hand.after(0.0)["clock_error_s"] == 0.0
    hand.catches_up, hand.error_ms = False, 600_000
    for said_s in (0.0, 0.0, 600.0):
        hand.after(5.0)
        hand.final()
        assert hand.after(0.0)["clock_error_s"] == said_s

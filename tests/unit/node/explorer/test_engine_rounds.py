"""What a node notes for the explorer: where it is in the protocol, and how soon its newest blocks were final."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from node.api_adapters import LAGS_KEPT_COUNT, EngineRounds
from tests.unit.node.api.small_network import ManualClock

CORE = SimpleNamespace(
    epoch=2, round=9, leader=1, finalized=SimpleNamespace(height=5), certified_branch=lambda: [b"6", b"7"]
)


def blocks(*heights: int) -> list[Any]:
    return [SimpleNamespace(header=SimpleNamespace(height=height, timestamp_ms=1_000 * height)) for height in heights]


def make_rounds(now_ms: int) -> EngineRounds:
    engine: Any = SimpleNamespace(core=CORE, rounds_timed_out_count=4)
    return EngineRounds(engine, ManualClock(now_ms))


def test_the_place_is_that_of_the_core_and_only_the_newest_blocks_are_remembered_by_the_clock() -> None:
    place = make_rounds(0).place()
    assert (place.epoch, place.round, place.leader) == (2, 9, 1)
    assert (place.certified_height, place.timed_out_count) == (7, 4)
    rounds = make_rounds(3_500)
    rounds.note_final(blocks(2, 3), None, None)  # type: ignore[arg-type]
    assert (rounds.finality_lag_ms(2), rounds.finality_lag_ms(3), rounds.finality_lag_ms(4)) == (1_500, 500, None)
    rounds = make_rounds(0)
    rounds.note_final(blocks(*range(1, LAGS_KEPT_COUNT + 2)), None, None)  # type: ignore[arg-type]
    assert rounds.finality_lag_ms(1) is None
    assert rounds.finality_lag_ms(2) is not None

"""Who asks many views at once has a share of the places, and leaves the others theirs."""

from __future__ import annotations

import pytest

from consensus.errors import BlockRobotError
from node.execution.sandboxed_contracts import (
    VIEWS_OF_SOURCE_MAX_COUNT,
    VIEWS_OF_VISIT_KEY_MAX_COUNT,
    VIEWS_WAITING_MAX_COUNT,
    ViewPlaces,
)
from node.limits.token_buckets import Source

GREEDY, MODEST = Source("session", "greedy"), Source("session", "modest")


def refusal(places: ViewPlaces, source: Source) -> str:
    try:
        places.take(source)
    except BlockRobotError as error:
        return f"{error.code}: {error.detail}"
    return ""


def fill(places: ViewPlaces, source: Source) -> int:
    """Take places until there is none, which names the source; return how many there were."""
    taken = 0
    while not (told := refusal(places, source)):
        taken += 1
    assert told.startswith(f"RATE_LIMITED: The budget of {source} ")
    return taken


def test_sources_take_a_share_and_many_keys_of_visits_at_one_address_share_one() -> None:
    places = ViewPlaces()
    assert fill(places, GREEDY) == VIEWS_OF_SOURCE_MAX_COUNT < VIEWS_WAITING_MAX_COUNT // 4
    assert fill(places, MODEST) == VIEWS_OF_SOURCE_MAX_COUNT
    places.give_back(GREEDY)
    assert fill(places, GREEDY) == 1
    places = ViewPlaces()
    keys = [Source("visit_keys", "192.0.2.1", f"{number:02}") for number in range(40)]
    taken = [fill(places, key) for key in keys]
    assert max(taken) == VIEWS_OF_VISIT_KEY_MAX_COUNT
    assert sum(taken) == VIEWS_OF_SOURCE_MAX_COUNT
    assert fill(places, MODEST) == VIEWS_OF_SOURCE_MAX_COUNT


def test_all_together_have_no_more_than_there_are() -> None:
    places = ViewPlaces()
    for number in range(VIEWS_WAITING_MAX_COUNT):
        places.take(Source("session", str(number)))
    with pytest.raises(BlockRobotError, match="VIEWS_BUSY"):
        places.take(MODEST)
    places.give_back(Source("session", "0"))
    places.take(MODEST)

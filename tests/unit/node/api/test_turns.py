"""Requests begin in turns: whoever has too many waiting is refused, and the others' go on."""

from __future__ import annotations

import asyncio

from consensus.errors import BlockRobotError
from node.api.access.request_rate_limiter import TURN_MAX_US, WAITING_MAX_COUNT, WAITING_OF_SOURCE_MAX_COUNT, FairQueue
from node.limits.token_buckets import Source


async def test_a_visit_that_floods_takes_not_all_places_and_turns_of_its_address() -> None:
    turns = FairQueue(lambda _who, _error: None)
    loud, quiet = (Source("visit_keys", "192.0.2.1", part) for part in ("loud", "quiet"))
    served: list[str] = []

    async def ask(source: Source, name: str) -> None:
        await turns.wait(source, TURN_MAX_US)
        served.append(name)

    first = asyncio.ensure_future(ask(loud, "first"))
    flood = [asyncio.ensure_future(ask(loud, "loud")) for _ in range(WAITING_OF_SOURCE_MAX_COUNT)]
    late = [asyncio.ensure_future(ask(quiet, "quiet")) for _ in range(3)]
    more = asyncio.ensure_future(ask(loud, "loud"))
    async with asyncio.timeout(10):
        results = await asyncio.gather(first, *flood, *late, more, return_exceptions=True)
    refused = [place for place, result in enumerate(results) if isinstance(result, BlockRobotError)]
    assert refused == [*range(len(flood) - 2, len(flood) + 1), len(results) - 1], "the newest of the loud one"
    assert served[:7].count("quiet") == 3
    await turns.wait(quiet, 1)


async def test_where_all_places_are_taken_who_has_most_makes_room_and_nobody_is_stopped() -> None:
    named: list[str] = []
    turns = FairQueue(lambda who, _error: named.append(who))
    sources = [Source("session", str(number)) for number in range(WAITING_MAX_COUNT // WAITING_OF_SOURCE_MAX_COUNT)]
    first = asyncio.ensure_future(turns.wait(sources[0], TURN_MAX_US))  # it takes the turn, so that all others wait
    waiting = [
        asyncio.ensure_future(turns.wait(source, TURN_MAX_US))
        for source in sources
        for _ in range(WAITING_OF_SOURCE_MAX_COUNT)
    ]
    late = asyncio.ensure_future(turns.wait(Source("session", "late"), 1))
    more = asyncio.ensure_future(turns.wait(sources[0], TURN_MAX_US))
    async with asyncio.timeout(10):
        results = await asyncio.gather(first, *waiting, late, more, return_exceptions=True)
    refused = [place for place, result in enumerate(results) if isinstance(result, BlockRobotError)]
    assert refused == [WAITING_OF_SOURCE_MAX_COUNT, len(results) - 1], "the newest of the first session"
    await turns.wait(Source("session", "late"), 1)
    assert named == [f"session {sources[0].name}"] * 2


async def test_visits_with_one_request_each_leave_places_to_others() -> None:
    turns = FairQueue(lambda _who, _error: None)
    visits = [Source("visit_keys", str(at % 8), str(at)) for at in range(WAITING_MAX_COUNT)]
    waiting = [asyncio.ensure_future(turns.wait(source, TURN_MAX_US)) for source in (visits[0], *visits)]
    late = asyncio.ensure_future(turns.wait(Source("session", "late"), 1))
    async with asyncio.timeout(10):
        results = await asyncio.gather(*waiting, late, return_exceptions=True)
    assert sum(isinstance(result, BlockRobotError) for result in results) == 1
    assert results[-1] is None

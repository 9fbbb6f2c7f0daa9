"""A node holds only so many bytes of requests that are not whole, of each source and of all."""

from __future__ import annotations

import asyncio
from contextlib import ExitStack

import pytest
from aiohttp.test_utils import TestServer

from consensus.errors import BlockRobotError
from consensus.limits import MIB_BYTES
from node.api import bodies as module
from node.api import create_api
from node.api.bodies import (
    BODIES_MAX_BYTES,
    BODIES_OF_ADDRESS_MAX_BYTES,
    BODIES_OF_SOURCE_MAX_BYTES,
    BODIES_OF_VISIT_KEY_MAX_BYTES,
    Bodies,
)
from node.limits.token_buckets import Source
from tests.unit.node.api.small_network import SmallLedger, SmallNode

STRANGER = Source("address", "192.0.2.7")


def test_what_one_source_has_in_the_node_is_bounded_and_free_again_afterwards() -> None:
    named: list[str] = []
    bodies = Bodies(lambda who, _error: named.append(who))
    for source, most in (
        (STRANGER, BODIES_OF_ADDRESS_MAX_BYTES),
        (Source("session", "ab"), BODIES_OF_SOURCE_MAX_BYTES),
    ):
        for _ in range(2):
            with bodies.of(source) as first, bodies.of(source) as second:
                first(most - 10)
                second(10)
                with pytest.raises(BlockRobotError, match="RATE_LIMITED"):
                    second(1)
    assert named == [str(STRANGER)] * 2 + ["session ab"] * 2


def test_one_visit_key_does_not_fill_what_all_of_its_address_may_hold() -> None:
    bodies = Bodies(lambda _who, _error: None)
    loud, quiet = (Source("visit_keys", "192.0.2.1", part) for part in ("loud", "quiet"))
    with bodies.of(loud) as first, bodies.of(quiet) as other:
        first(BODIES_OF_VISIT_KEY_MAX_BYTES)
        with pytest.raises(BlockRobotError, match="RATE_LIMITED"):
            first(1)
        other(BODIES_OF_VISIT_KEY_MAX_BYTES)
    keys = [Source("visit_keys", "192.0.2.1", str(n)) for n in range(BODIES_OF_SOURCE_MAX_BYTES // MIB_BYTES)]
    count = BODIES_OF_SOURCE_MAX_BYTES // BODIES_OF_VISIT_KEY_MAX_BYTES
    with ExitStack() as held:
        for key in keys[:count]:
            held.enter_context(bodies.of(key))(BODIES_OF_VISIT_KEY_MAX_BYTES)
        with pytest.raises(BlockRobotError, match="RATE_LIMITED"):
            held.enter_context(bodies.of(keys[count]))(1)
    with bodies.of(loud) as hold:
        hold(BODIES_OF_VISIT_KEY_MAX_BYTES)


def test_all_together_have_no_more_than_the_node_may_hold() -> None:
    bodies = Bodies(lambda _who, _error: pytest.fail("Nobody alone has too much."))
    count = BODIES_MAX_BYTES // BODIES_OF_SOURCE_MAX_BYTES
    held = [bodies.of(Source("session", str(place))) for place in range(count)]
    for one in held:
        one.__enter__()(BODIES_OF_SOURCE_MAX_BYTES)
    with bodies.of(STRANGER) as hold, pytest.raises(BlockRobotError, match="RATE_LIMITED"):
        hold(1)
    held[0].__exit__(None, None, None)
    with bodies.of(STRANGER) as hold:
        hold(1)


async def test_requests_that_are_begun_and_not_ended_are_refused_beyond_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "BODIES_OF_SOURCE_MAX_BYTES", 200_000)
    node = SmallNode.around(await SmallLedger().start(), "n0")
    async with TestServer(create_api(node.services)) as server:
        links = []
        for _ in range(3):
            reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
            writer.write(b"POST /v1/transactions HTTP/1.1\r\nHost: x\r\nContent-Length: 100000\r\n\r\n" + bytes(90_000))
            links.append((reader, writer))
        answers = [asyncio.create_task(reader.read(100)) for reader, _ in links]
        done, waiting = await asyncio.wait(answers, return_when=asyncio.FIRST_COMPLETED, timeout=10)
        assert [task.result()[:12] for task in done] == [b"HTTP/1.1 429"]
        assert len(waiting) == 2
        for task in waiting:
            task.cancel()
        for _, writer in links:
            writer.close()

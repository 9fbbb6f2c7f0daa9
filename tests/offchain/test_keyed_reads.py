"""Reads by one key: together while one is under way, never of an earlier state, each with its own answer or failure."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

import pytest

from consensus.errors import BlockRobotError
from node.custody.keyed_reads import KEYS_AT_ONCE_MAX_COUNT, KeyedReads
from node.custody.stores.mongo_documents import Document


class Server:
    """Answers when it is let, with what it holds as the query begins."""

    def __init__(self) -> None:
        self.held: dict[bytes, int] = {}
        self.asked: list[list[bytes]] = []
        self.may_answer = asyncio.Event()
        self.reads = KeyedReads("key", self._read)

    async def _read(self, keys: Sequence[bytes]) -> list[Document]:
        self.asked.append(sorted(keys))
        found: list[Document] = [{"key": key, "value": self.held[key]} for key in keys if key in self.held]
        await self.may_answer.wait()
        if b"broken" in keys:
            raise BlockRobotError("STORE_UNAVAILABLE")
        return found

    def ask(self, *keys: bytes) -> list[asyncio.Task[list[Document]]]:
        return [asyncio.ensure_future(self.reads.of(key)) for key in keys]


async def turns() -> None:
    for _ in range(5):
        await asyncio.sleep(0)


async def test_what_is_asked_for_meanwhile_is_one_query_and_sees_what_was_written_meanwhile() -> None:
    server = Server()
    server.held[b"a"] = 1
    first = server.ask(b"a")
    await turns()
    server.held[b"a"] = 2
    later = server.ask(b"a", b"b", b"a")
    server.may_answer.set()
    values = [[row["value"] for row in rows] for rows in await asyncio.gather(*first, *later)]
    assert values == [[1], [2], [], [2]]
    assert server.asked == [[b"a"], [b"a", b"b"]]


async def test_a_query_asks_for_so_many_at_most() -> None:
    server = Server()
    server.may_answer.set()
    keys = [bytes([number]) for number in range(KEYS_AT_ONCE_MAX_COUNT + 1)]
    await asyncio.gather(*server.ask(*keys))
    assert server.asked == [keys[:-1], keys[-1:]]


async def test_a_failure_is_told_to_all_that_it_concerns_and_the_next_are_read() -> None:
    server = Server()
    broken = server.ask(b"broken", b"a")
    await turns()
    server.held[b"c"] = 3
    whole = server.ask(b"c")
    server.may_answer.set()
    for task in broken:
        with pytest.raises(BlockRobotError, match="STORE_UNAVAILABLE"):
            await task
    assert [row["value"] for row in await whole[0]] == [3]


async def test_who_gives_up_does_not_keep_the_others_from_their_answers() -> None:
    server = Server()
    server.held[b"a"] = 1
    gone, stays = server.ask(b"a", b"a")
    await turns()
    gone.cancel()
    server.may_answer.set()
    assert [row["value"] for row in await stays] == [1]
    assert gone.cancelled()


async def test_those_that_wait_as_the_store_closes_are_told() -> None:
    server = Server()
    waiting = server.ask(b"a")
    await turns()
    waiting += server.ask(b"b")
    await turns()
    await server.reads.close()
    await asyncio.wait(waiting, timeout=5)
    assert [str(task.exception()).partition(":")[0] for task in waiting] == ["STORE_UNAVAILABLE"] * 2

"""Reads by one key from a server: those that come while another is under way are one query."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress

from consensus.errors import BlockRobotError
from node.custody.stores.mongo_documents import Document

KEYS_AT_ONCE_MAX_COUNT = 8


class KeyedReads:
    """Each query begins after all that it answers were asked for, so nobody is told of an earlier state."""

    def __init__(self, field: str, read: Callable[[Sequence[bytes]], Awaitable[list[Document]]]) -> None:
        """`read`: the documents that have one of these keys in that field."""
        self._field = field
        self._read = read
        self._waiting: list[tuple[bytes, asyncio.Future[list[Document]]]] = []
        self._task: asyncio.Task[None] | None = None

    async def of(self, key: bytes) -> list[Document]:
        """The documents with this key. Raises as `read`."""
        answer: asyncio.Future[list[Document]] = asyncio.get_running_loop().create_future()
        self._waiting.append((key, answer))
        if self._task is None:
            self._task = asyncio.create_task(self._answer_all())
        return await answer

    async def close(self) -> None:
        if self._task is not None:
            self._task.cancel()
            with suppress(asyncio.CancelledError):
                await self._task

    async def _answer_all(self) -> None:
        try:
            while self._waiting:
                asked = self._waiting[:KEYS_AT_ONCE_MAX_COUNT]
                try:
                    found = await self._read(sorted({key for key, _ in asked}))
                except Exception as error:  # noqa: BLE001 - whoever asked is told
                    _fail(asked, error)
                else:
                    for key, answer in asked:
                        if not answer.done():
                            answer.set_result([document for document in found if document.get(self._field) == key])
                del self._waiting[: len(asked)]
        finally:
            self._task = None
            _fail(self._waiting, BlockRobotError("STORE_UNAVAILABLE", "The store was closed meanwhile."))
            self._waiting.clear()


def _fail(asked: Sequence[tuple[bytes, asyncio.Future[list[Document]]]], error: Exception) -> None:
    for _, answer in asked:
        if not answer.done():
            answer.set_exception(error)

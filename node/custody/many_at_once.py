"""Work on many items, of which some are under way at once."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from typing import TypeVar

T = TypeVar("T")

AT_ONCE_COUNT = 16


async def for_each(items: Sequence[T], work: Callable[[T], Awaitable[None]]) -> None:
    """Up to 16 at once, one of them in this task; none is under way any more when this returns or raises."""
    left = iter(items)

    async def take() -> None:
        for item in left:
            await work(item)

    try:
        async with asyncio.TaskGroup() as group:
            for _ in items[1:AT_ONCE_COUNT]:
                group.create_task(take())
            await take()
    except BaseExceptionGroup as errors:
        raise errors.exceptions[0] from None

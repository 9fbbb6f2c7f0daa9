"""Protocol of a store of blobs, where a custodian may keep its clips' ciphertexts."""

from __future__ import annotations

from collections.abc import AsyncIterator
from types import TracebackType
from typing import Protocol, Self

OWNER_NAME = "custodian"
"""Of the blob that says whose place it is: without it the place is not there."""


class BlobStore(Protocol):
    """Bytes by name, `/` between folders. Methods raise STORE_UNAVAILABLE.

    What `put` and `delete` returned from lasts, and the next `get`, `has` and `names` see it.
    """

    async def __aenter__(self) -> Self: ...

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...

    async def put(self, name: str, content: bytes) -> None:
        """Replaces what has the name, whole or not at all."""
        ...

    async def get(self, name: str, max_bytes: int) -> bytes | None:
        """None if there is none, or a larger one."""
        ...

    async def delete(self, name: str) -> None:
        """An unknown one is no error."""
        ...

    async def has(self, name: str) -> bool: ...

    def names(self, prefix: str = "") -> AsyncIterator[str]:
        """Those that begin so; in no order."""
        ...

    async def clear_unfinished(self) -> None:
        """Delete what cut writes left; only by the custodian whose place it is, before it writes."""
        ...

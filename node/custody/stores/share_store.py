"""Storage of standing grants and wrapped key parts.

A part is wrapped under its own erase key outside the store, and staged until its grant is final. Writes are idempotent.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

PartStatus = Literal["staged", "confirmed"]
PartField = Literal["grant_id", "record_id", "owner"]


@dataclass(frozen=True, slots=True)
class ShareRow:
    """A final standing grant: record ids (16 bytes), owner (33 bytes), end in ms."""

    grant_id: bytes
    owner: bytes
    records: tuple[bytes, ...]
    until_ms: int
    height: int


@dataclass(frozen=True, slots=True)
class PartRow:
    """A granted record's wrapped part and its erase key slot.

    `height`: the grant's, 0 while staged (`valid_until_ms`: transaction expiry).
    """

    grant_id: bytes
    record_id: bytes
    owner: bytes
    valid_until_ms: int
    status: PartStatus
    height: int
    slot: int
    wrapped: bytes


@dataclass(frozen=True, slots=True)
class PartPlace:
    """Where a part and its erase key are, without its bytes."""

    grant_id: bytes
    record_id: bytes
    owner: bytes
    status: PartStatus
    height: int
    slot: int


class ShareStore(Protocol):
    """Storage of shares in a custodian's store. Every method raises STORE_UNAVAILABLE."""

    async def put_share(self, share: ShareRow) -> None: ...

    async def share(self, grant_id: bytes) -> ShareRow | None: ...

    async def shares_over(self, at_ms: int, limit: int) -> list[bytes]:
        """Those with `until_ms <= at_ms`, the oldest end first."""
        ...

    async def shares_of(self, owner: bytes) -> list[ShareRow]: ...

    async def missing_over(self, at_ms: int) -> list[bytes]:
        """Return missing records with `expires_at_ms <= at_ms`, oldest first; erase their keys before the next
        checkpoint.
        """
        ...

    async def forget_share(self, grant_id: bytes) -> None:
        """An unknown one is no error."""
        ...

    def all_shares(self) -> AsyncIterator[ShareRow]: ...

    async def put_part(self, row: PartRow) -> None:
        """Replaces any row of the same grant and record."""
        ...

    async def part(self, grant_id: bytes, record_id: bytes) -> PartRow | None: ...

    async def parts_of(self, field: PartField, keys: Sequence[bytes]) -> list[PartPlace]: ...

    async def lapsed_parts(self, at_ms: int, limit: int) -> list[PartPlace]:
        """Return staged parts whose grant cannot become final: `valid_until_ms <= at_ms`."""
        ...

    async def confirm_parts(self, grant_id: bytes, record_ids: Sequence[bytes], height: int) -> None:
        """Mark these parts' grant as final; missing parts are not created."""
        ...

    async def erase_parts(self, slots: Sequence[int]) -> None:
        """Delete the parts whose erase keys are, or were, in these slots."""
        ...

    def all_parts(self) -> AsyncIterator[PartPlace]: ...

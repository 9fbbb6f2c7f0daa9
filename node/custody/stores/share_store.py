"""What a custodian keeps of shares, in words of its store: grants that stand, and parts of keys. Must never hold one bare.

A part row is a package and one custodian's parts of the key that opens it, wrapped under an erase key of its own, which
lies outside of the store. It is staged until its grant is final. Every write is idempotent.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

PartStatus = Literal["staged", "confirmed"]
PartField = Literal["grant_id", "record_id", "owner"]


@dataclass(frozen=True, slots=True)
class ShareRow:
    """A final grant that stands: these records (16 bytes each) of an owner (33 bytes), until a time in ms."""

    grant_id: bytes
    owner: bytes
    records: tuple[bytes, ...]
    until_ms: int
    height: int


@dataclass(frozen=True, slots=True)
class PartRow:
    """What this custodian holds of one record of a grant, wrapped, and the slot of the erase key.

    `height` is the grant's, 0 while it is staged; until then `valid_until_ms` is the expiry of its transaction.
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
    """The part of a custodian's store that is about shares. Every method raises STORE_UNAVAILABLE."""

    async def put_share(self, share: ShareRow) -> None:
        """Keep a grant that stands, in place of any row of the same."""
        ...

    async def share(self, grant_id: bytes) -> ShareRow | None:
        """Return a grant that stands, or None."""
        ...

    async def shares_over(self, at_ms: int, limit: int) -> list[bytes]:
        """Return grants with `until_ms <= at_ms`, the oldest end first."""
        ...

    async def shares_of(self, owner: bytes) -> list[ShareRow]:
        """Return the grants of a visit that stand, by its first key and by their ids."""
        ...

    async def missing_over(self, at_ms: int) -> list[bytes]:
        """Return the records whose clips are missing here and expired (`expires_at_ms <= at_ms`), the oldest first.

        The next checkpoint forgets them; what is held of their keys has to go before.
        """
        ...

    async def forget_share(self, grant_id: bytes) -> None:
        """Forget a grant; one that is not there is no error."""
        ...

    def all_shares(self) -> AsyncIterator[ShareRow]:
        """Yield every grant that stands, by its id."""
        ...

    async def put_part(self, row: PartRow) -> None:
        """Keep a part, in place of any row of the same grant and record."""
        ...

    async def part(self, grant_id: bytes, record_id: bytes) -> PartRow | None:
        """Return one part, or None."""
        ...

    async def parts_of(self, field: PartField, keys: Sequence[bytes]) -> list[PartPlace]:
        """Return the parts of these grants, records or owners, by grant and record."""
        ...

    async def lapsed_parts(self, at_ms: int, limit: int) -> list[PartPlace]:
        """Return staged parts whose grant can no longer become final: `valid_until_ms <= at_ms`."""
        ...

    async def confirm_parts(self, grant_id: bytes, record_ids: Sequence[bytes], height: int) -> None:
        """Note that the grant of these parts is final; none that is not there is made."""
        ...

    async def erase_parts(self, slots: Sequence[int]) -> None:
        """Delete the parts whose erase keys are, or were, in these slots."""
        ...

    def all_parts(self) -> AsyncIterator[PartPlace]:
        """Yield where every part is, by grant and record."""
        ...

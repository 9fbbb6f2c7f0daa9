"""Mandates: proposed by one officer, approved by a second, accepted by the representative, ended by anyone concerned.
Reads are proven; steps are signed with the member key.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from clients.sdk.chain.proved_rows import proved_list, proved_row, proved_rows, put_query
from clients.sdk.chain.receipts import FinalReceipt
from clients.wallet.ledger.id_prefix import MANDATE, resolve_id_prefix
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.text_catalogue import refusal
from consensus.errors import BlockRobotError
from consensus.members.handles import decode_short, encode_short, is_short
from consensus.state import mandates as schema
from consensus.state.identity import HANDLE, handle_from, member_with
from consensus.state.mandates import ACT, ACT_COUNT, OF, PERSON, PERSON_COUNT, ActRow, MandateRow

HANDLE_BYTES = 32
PROPOSED, APPROVED, ACTIVE, ENDED, LAPSED, RESTING = "proposed", "approved", "active", "ended", "lapsed", "resting"
OPEN = frozenset({PROPOSED, APPROVED, ACTIVE, RESTING})


@dataclass(frozen=True, slots=True)
class Mandate:
    """A proven mandate. `status`: proposed, approved, active, ended, lapsed (expired), or resting (the representative
    is represented).
    """

    mandate_id: bytes
    state: MandateRow
    status: schema.Standing

    @property
    def is_open(self) -> bool:
        return self.status in OPEN


class Mandates:
    """A network's mandates, as one wallet sees them."""

    def __init__(self, wallet: Wallet) -> None:
        self._wallet = wallet
        self._key = wallet.keys.identity
        self._read = wallet.reading(self._key)

    # Looking

    async def read_all(self) -> list[Mandate]:
        """In the order of their proposals. Raises NOT_REGISTERED."""
        return await self._mandates(await self._all_ids())

    async def _all_ids(self) -> list[bytes]:
        await self._wallet.require_registered()
        return await proved_list(self._read, schema.MANDATE_COUNT, schema.MANDATE_NUMBER)

    async def _own_ids(self) -> list[bytes]:
        await self._wallet.require_registered()
        own = self._wallet.store.content.handle
        count = await proved_row(self._read, PERSON_COUNT, own) or 0
        keys = [PERSON.key(own, number) for number in range(count)]
        found = await self._read(keys)
        return [PERSON.convert(found[key]) for key in keys]

    async def _mandates(self, ids: Sequence[bytes]) -> list[Mandate]:
        if not ids:
            return []
        rows = await proved_rows(self._read, schema.MANDATE, ids)
        now_ms = (await self._wallet.network.newest_header(self._key)).timestamp_ms
        return [Mandate(each, row, await self._standing(row, now_ms)) for each, row in zip(ids, rows, strict=True)]

    async def _standing(self, row: MandateRow, now_ms: int) -> schema.Standing:
        return await put_query(self._read, lambda state: schema.standing(state, row, now_ms))

    async def read_own(self) -> list[Mandate]:
        return await self._mandates(await self._own_ids())

    async def over_own(self) -> bytes | None:
        mandate_id = await self._of(self._wallet.store.content.handle)
        found = await self._mandates([] if mandate_id is None else [mandate_id])
        return next((mandate.mandate_id for mandate in found if mandate.is_open), None)

    async def _of(self, handle: bytes) -> bytes | None:
        return await proved_row(self._read, OF, handle)

    async def find(self, start: str, *, own: bool = False) -> Mandate:
        """Find by id prefix (hex). Raises MANDATE_NOT_FOUND, NAME_TOO_SHORT etc."""
        known = await (self._own_ids() if own else self._all_ids())
        (found,) = await self._mandates([known[resolve_id_prefix(MANDATE, [one.hex() for one in known], start)]])
        return found

    async def trail(self, mandate: Mandate) -> list[ActRow]:
        """All acts in order, proven complete."""
        count = await proved_row(self._read, ACT_COUNT, mandate.mandate_id) or 0
        keys = [ACT.key(mandate.mandate_id, number) for number in range(count)]
        found = await self._read(keys)
        return [ACT.convert(found[key]) for key in keys]

    async def read_handle(self, wanted: str) -> bytes:
        """Return the whole handle. Raises HANDLE_MISTYPED, HANDLE_NOT_FOUND."""
        await self._wallet.require_registered()
        if is_short(wanted):
            found = await put_query(self._read, partial(handle_from, start=decode_short(wanted)))
            if found is None:
                raise BlockRobotError("HANDLE_NOT_FOUND")
            return found
        try:
            handle = bytes.fromhex("".join(wanted.replace("-", "").split()))
        except ValueError:
            handle = b""
        if len(handle) != HANDLE_BYTES or await proved_row(self._read, HANDLE, handle) is None:
            raise BlockRobotError("HANDLE_NOT_FOUND")
        return handle

    async def organisation_of(self, handle: bytes) -> str:
        """Which registered it. Raises HANDLE_NOT_FOUND."""
        member = await put_query(self._read, lambda state: member_with(state, handle))
        if member is None:
            raise BlockRobotError("HANDLE_NOT_FOUND")
        return member.org

    async def acting_for(self, handle: bytes) -> Mandate:
        """Return the active mandate. Raises MANDATE_MISSING."""
        mandate_id = await self._of(handle)
        for mandate in await self._mandates([] if mandate_id is None else [mandate_id]):
            if mandate.state.representative == self._wallet.store.content.handle and mandate.status == ACTIVE:
                return mandate
        raise refusal("MANDATE_MISSING", "mandate_none", name=encode_short(handle))

    # Deciding

    async def propose(
        self, handle: bytes, representative: bytes, papers: bytes, acts: Sequence[str], until_ms: int
    ) -> bytes:
        """Return its id. Raises CALL_REFUSED."""
        return (await self._call("propose", [handle, representative, papers, list(acts), until_ms])).txid

    async def approve(self, mandate: Mandate) -> None:
        """As second officer. Raises CALL_REFUSED."""
        await self._call("approve", [mandate.mandate_id])

    async def accept(self, mandate: Mandate) -> None:
        """Accept it as the representative. Raises CALL_REFUSED."""
        await self._call("accept", [mandate.mandate_id])

    async def end(self, mandate: Mandate) -> None:
        """End a mandate; one that lapsed may be closed by others too. Raises CALL_REFUSED."""
        content = self._wallet.store.content
        entitled = content.handle in (mandate.state.handle, mandate.state.representative)
        if not entitled and content.role == "officer":
            entitled = await self.organisation_of(content.handle) == mandate.state.org
        await self._call("end" if entitled else "close", [mandate.mandate_id])

    async def _call(self, entry: str, arguments: list[Any]) -> FinalReceipt:
        return await self._wallet.network.call(self._key, "mandates", entry, arguments)

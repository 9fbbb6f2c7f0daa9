"""Mandates as officers, representatives and the represented see and use them. Must never send a paper anywhere.

Two officers give one, the representative accepts it, and any of those concerned ends it. All of it is read with proofs;
every step is signed with the own member key.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from clients.sdk.receipts import FinalReceipt
from clients.wallet.language import refusal
from clients.wallet.naming import MANDATE, find_named
from clients.wallet.wallet import Wallet
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import u32, u64
from consensus.records.handles import decode_short, encode_short, is_short, short_handle_key

HANDLE_BYTES = 32
PROPOSED, APPROVED, ACTIVE, ENDED, LAPSED, RESTING = "proposed", "approved", "active", "ended", "lapsed", "resting"
OPEN = frozenset({PROPOSED, APPROVED, ACTIVE, RESTING})
_REPRESENTATIVE_ROLES = frozenset({"officer", "staff", "subject"})
_COUNT_KEY = b"mandates\x00mandate-count"
_NUMBER = b"mandates\x00mandate-number/"
_MANDATE = b"mandates\x00mandate/"
_OF = b"mandates\x00of/"
_ACT_COUNT = b"mandates\x00act-count/"
_ACT = b"mandates\x00act/"
_PERSON_COUNT = b"mandates\x00person-count/"
_PERSON = b"mandates\x00person/"
_HANDLE = b"identity\x00handle/"
_MEMBER = b"identity\x00member/"
_REMOVED = b"identity\x00removed/"


@dataclass(frozen=True, slots=True)
class Mandate:
    """A mandate or a proposal of one, proven. `state` is the contract's row.

    `status` is what it stands at: proposed, approved, active, ended, lapsed because it is over, though nobody ended it, or
    resting while somebody acts for the representative.
    """

    mandate_id: bytes
    state: dict[str, Any]
    status: str

    @property
    def is_open(self) -> bool:
        """Whether it is in force, or may still come into force."""
        return self.status in OPEN


def _is_over(state: dict[str, Any], now_ms: int) -> bool:
    """Tell whether the time of a mandate, or for which a proposal of one waits, has passed."""
    last_ms = state["until_ms"] - 1
    if state["status"] in (PROPOSED, APPROVED):
        last_ms = min(last_ms, state["ends_ms"])
    return bool(state["status"] != ENDED and now_ms > last_ms)


@dataclass(frozen=True, slots=True)
class Act:
    """What was done under a mandate: `given`, `refused`, `withdrawn` or `objected`."""

    kind: str
    time_ms: int
    height: int
    txid: bytes
    data: dict[str, Any]


class Mandates:
    """The mandates of a network, as one wallet sees them."""

    def __init__(self, wallet: Wallet) -> None:
        self._wallet = wallet
        self._key = wallet.keys.identity

    # Looking

    async def read_all(self) -> list[Mandate]:
        """Return all mandates in the order in which they were proposed. Raises NOT_REGISTERED."""
        return await self._read(await self._all_ids())

    async def _all_ids(self) -> list[bytes]:
        await self._wallet.require_registered()
        count = (await self._wallet.values([_COUNT_KEY], self._key))[_COUNT_KEY] or 0
        return await self._values([_NUMBER + u64(number) for number in range(count)])

    async def _own_ids(self) -> list[bytes]:
        await self._wallet.require_registered()
        own = self._wallet.store.content.handle
        (count,) = await self._values([_PERSON_COUNT + own])
        return await self._values([_PERSON + own + u32(number) for number in range(count or 0)])

    async def _values(self, keys: Sequence[bytes]) -> list[Any]:
        found = await self._wallet.values(keys, self._key)
        return [found[key] for key in keys]

    async def _read(self, ids: Sequence[bytes]) -> list[Mandate]:
        if not ids:
            return []
        states = await self._values([_MANDATE + mandate_id for mandate_id in ids])
        now_ms = (await self._wallet.network.newest_header(self._key)).timestamp_ms
        return [Mandate(one, state, await self._status(state, now_ms)) for one, state in zip(ids, states, strict=True)]

    async def _status(self, state: dict[str, Any], now_ms: int) -> str:
        """Return what a mandate stands at, by the same conditions as the contract's `holds`."""
        if _is_over(state, now_ms):
            return LAPSED
        if state["status"] != ACTIVE:
            return str(state["status"])
        (removed_ms,) = await self._values([_REMOVED + state["org"].encode()])
        there = await self._role_of(state["handle"]) == "subject" and (removed_ms or -1) < state["proposed_ms"]
        if not there or await self._role_of(state["representative"]) not in _REPRESENTATIVE_ROLES:
            return LAPSED
        over_id = await self._of(state["representative"])
        (over,) = await self._values([] if over_id is None else [_MANDATE + over_id]) or [None]
        is_represented = over is not None and over["status"] == ACTIVE and now_ms < over["until_ms"]
        return RESTING if is_represented else ACTIVE

    async def _role_of(self, handle: bytes) -> str:
        """Return the role of who has a handle, or an empty text for who is no active member any more."""
        (key,) = await self._values([_HANDLE + handle])
        (member,) = await self._values([_MEMBER + key])
        (removed_ms,) = await self._values([_REMOVED + member["org"].encode()])
        gone = member["role"] != "subject" and member["since"] <= (-1 if removed_ms is None else removed_ms)
        return "" if gone or member["status"] != "active" else str(member["role"])

    async def read_own(self) -> list[Mandate]:
        """Return those by which this wallet's person is represented, or represents somebody."""
        return await self._read(await self._own_ids())

    async def over_own(self) -> bytes | None:
        """Return the id of the mandate by which somebody acts for this wallet's person, or may come to."""
        mandate_id = await self._of(self._wallet.store.content.handle)
        found = await self._read([] if mandate_id is None else [mandate_id])
        return next((mandate.mandate_id for mandate in found if mandate.is_open), None)

    async def _of(self, handle: bytes) -> bytes | None:
        found = (await self._wallet.values([_OF + handle], self._key))[_OF + handle]
        return found if isinstance(found, bytes) else None

    async def find(self, start: str, *, own: bool = False) -> Mandate:
        """Return the mandate whose id (hexadecimal) begins so. Raises MANDATE_NOT_FOUND, NAME_TOO_SHORT and the like."""
        known = await (self._own_ids() if own else self._all_ids())
        (found,) = await self._read([known[find_named(MANDATE, [one.hex() for one in known], start)]])
        return found

    async def trail(self, mandate: Mandate) -> list[Act]:
        """Return everything that was done under a mandate, in order; its length is proven, so nothing is left out."""
        place = _ACT_COUNT + mandate.mandate_id
        count = (await self._wallet.values([place], self._key))[place] or 0
        keys = [_ACT + mandate.mandate_id + u32(number) for number in range(count)]
        rows = await self._wallet.values(keys, self._key)
        return [
            Act(row["kind"], row["time"], row["height"], row["txid"], row["data"])
            for row in (rows[key] for key in keys)
        ]

    async def read_handle(self, wanted: str) -> bytes:
        """Return the handle that is meant, whole or in short. Raises HANDLE_MISTYPED, HANDLE_NOT_FOUND."""
        await self._wallet.require_registered()
        if is_short(wanted):
            short = decode_short(wanted)
            key = short_handle_key(short)
            handle = (await self._wallet.values([key], self._key))[key]
            if isinstance(handle, bytes) and handle.startswith(short):
                return handle
            raise BlockRobotError("HANDLE_NOT_FOUND")
        try:
            handle = bytes.fromhex("".join(wanted.replace("-", "").split()))
        except ValueError:
            handle = b""
        key = _HANDLE + handle
        if len(handle) != HANDLE_BYTES or (await self._wallet.values([key], self._key))[key] is None:
            raise BlockRobotError("HANDLE_NOT_FOUND")
        return handle

    async def organisation_of(self, handle: bytes) -> str:
        """Return the organisation that registered a person. Raises HANDLE_NOT_FOUND."""
        key = _HANDLE + handle
        member = (await self._wallet.values([key], self._key))[key]
        row = None
        if member is not None:
            row = (await self._wallet.values([_MEMBER + member], self._key))[_MEMBER + member]
        if row is None:
            raise BlockRobotError("HANDLE_NOT_FOUND")
        return str(row["org"])

    async def acting_for(self, handle: bytes) -> Mandate:
        """Return the mandate by which this wallet's person acts for another now. Raises MANDATE_MISSING."""
        mandate_id = await self._of(handle)
        for mandate in await self._read([] if mandate_id is None else [mandate_id]):
            if mandate.state["representative"] == self._wallet.store.content.handle and mandate.status == ACTIVE:
                return mandate
        raise refusal("MANDATE_MISSING", "mandate_none", name=encode_short(handle))

    # Deciding

    async def propose(
        self, handle: bytes, representative: bytes, papers: bytes, acts: Sequence[str], until_ms: int
    ) -> bytes:
        """Propose that one member acts for another; return the id. Raises CALL_REFUSED with the contract's code."""
        return (await self._call("propose", [handle, representative, papers, list(acts), until_ms])).txid

    async def approve(self, mandate: Mandate) -> None:
        """Agree as the second officer. Raises CALL_REFUSED with the contract's code."""
        await self._call("approve", [mandate.mandate_id])

    async def accept(self, mandate: Mandate) -> None:
        """Take it on as the representative. Raises CALL_REFUSED with the contract's code."""
        await self._call("accept", [mandate.mandate_id])

    async def end(self, mandate: Mandate) -> None:
        """End it; one of others, which only its officers and its two persons end, is closed if it holds no more.

        Raises CALL_REFUSED with the contract's code.
        """
        content = self._wallet.store.content
        entitled = content.handle in (mandate.state["handle"], mandate.state["representative"])
        if not entitled and content.role == "officer":
            entitled = await self.organisation_of(content.handle) == mandate.state["org"]
        await self._call("end" if entitled else "close", [mandate.mandate_id])

    async def _call(self, entry: str, arguments: list[Any]) -> FinalReceipt:
        return await self._wallet.network.call(self._key, "mandates", entry, arguments)

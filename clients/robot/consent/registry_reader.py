"""Reads proved keys, status and consents of everybody on a roster, in fixed order, so a node learns nothing of who is near.

Two on-chain numbers show changes; while equal, a small proof renews a reading.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

from clients.robot.pairing.rosters import RosterBook
from clients.sdk.chain.proved_rows import ProvingClient, in_session
from clients.sdk.quorum import HeaderClient, confirm_with_quorum, is_rejected_by_network
from consensus.errors import BlockRobotError
from consensus.members.roster import RosterRow
from consensus.primitives.keys import PrivateKey
from consensus.state import consent, identity
from consensus.state.consent import CHOICES, Choices, read_choices
from consensus.state.identity import HANDLE, MEMBER, REGISTRAR, MemberRow

_COUNTS = (identity.CHANGES.flat, consent.CHANGES.flat)


class RegistryClient(ProvingClient, Protocol):
    """`clients.sdk.network_client.NetworkClient`."""

    async def catch_up(self, key: PrivateKey) -> object:
        """Use the node with the newest final header."""


class Majority(Protocol):
    """What needs several nodes' confirmation."""

    async def confirm_with_quorum(self) -> bool:
        """Return whether a quorum of producers answered; then refuse older reads."""

    async def is_rejected_by_network(self) -> bool:
        """Tell whether no node takes the robot for a member any more."""


class NetworkMajority:
    """Nodes asked in the robot's session."""

    def __init__(self, client: HeaderClient, key: PrivateKey) -> None:
        self._client = client
        self._key = key

    async def confirm_with_quorum(self) -> bool:
        return await confirm_with_quorum(self._client, self._key)

    async def is_rejected_by_network(self) -> bool:
        return await is_rejected_by_network(self._client, self._key)


@dataclass(frozen=True, slots=True)
class RegistrySnapshot:
    """One block's proof; choices by handle."""

    height: int
    timestamp_ms: int
    counts: tuple[Any, ...]
    people: dict[bytes, Choices]


class RegistryReader:
    """Reads the registry for one roster, in the robot's session."""

    def __init__(self, client: RegistryClient, key: PrivateKey, roster: RosterBook) -> None:
        self._client = client
        self._key = key
        self._rows = roster.rows
        self._signer = roster.signer

    async def catch_up(self) -> None:
        """Raises NODE_UNREACHABLE and others."""
        await self._client.catch_up(self._key)

    async def read(self, known: RegistrySnapshot | None) -> RegistrySnapshot:
        """Return a new reading; `known` is carried on while nothing changed. Change numbers are read first: later changes
        show next time. Raises PROOF_INVALID, PROOF_STALE, network errors, and ROSTER_INVALID if whoever signed the roster
        is no registrar of the robot's organisation.
        """
        office = (MEMBER.key(self._key.public_key), REGISTRAR.key(self._signer))
        state = await self._client.state_values([*_COUNTS, *office], self._key)
        robot = MEMBER.among(state.values, self._key.public_key)
        if robot is not None and REGISTRAR.among(state.values, self._signer) != robot.org:
            raise BlockRobotError(
                "ROSTER_INVALID",
                f"The key that signed the roster is no registrar's of {robot.org}, or no more: have it made anew there.",
            )
        counts = tuple(state.values[key] for key in _COUNTS)
        unchanged = known is not None and counts == known.counts
        people = known.people if known is not None and unchanged else await self._read_whole()
        return RegistrySnapshot(state.height, state.timestamp_ms, counts, people)

    async def _read_whole(self) -> dict[bytes, Choices]:
        read = in_session(self._client, self._key)
        handles = [row.handle for row in self._rows]
        values = await read([HANDLE.key(handle) for handle in handles])
        owners = {handle: HANDLE.among(values, handle) for handle in handles}
        members = await read([MEMBER.key(owner) for owner in owners.values() if owner is not None])
        choices = await read([CHOICES.key(handle) for handle in handles])
        found = {}
        for row in self._rows:
            owner = owners[row.handle]
            member = None if owner is None else MEMBER.among(members, owner)
            if member is not None and _agrees(row, member):
                found[row.handle] = read_choices(choices[CHOICES.key(row.handle)])
        return found


def _agrees(row: RosterRow, member: MemberRow) -> bool:
    keys = (member.handle, member.spend, member.view, member.sealing)
    return member.is_active and keys == (row.handle, row.spend, row.view, row.sealing)

"""The robot's roster in memory: which tag belongs to whom, today. Must never look one handle up at a node.

The roster is read whole from a sealed file; asking a node about one tag would tell it who stands before the robot.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import msgspec

from clients.robot.identity import RobotIdentity
from clients.sdk.http import PROOF_KEYS_MAX_COUNT, NetworkClient
from consensus.errors import BlockRobotError
from consensus.genesis import Genesis
from consensus.primitives.keys import PrivateKey
from consensus.records.roster import Roster, RosterRow, open_roster, roster_tag


class RosterBook:
    """Finds the bearer of a tag by HMAC(roster key, UID)."""

    def __init__(self, roster: Roster) -> None:
        self._key = roster.key
        self._rows: dict[bytes, RosterRow] = {row.tag: row for row in roster.rows}

    def __len__(self) -> int:
        return len(self._rows)

    def find(self, uid: str) -> RosterRow | None:
        """Return the row of a tag, or None if the tag is nobody's who is registered."""
        return self._rows.get(roster_tag(self._key, uid))

    async def confirm(self, client: NetworkClient, key: PrivateKey) -> int:
        """Keep only the rows that the chain proves, and return how many were dropped.

        The roster is asked for whole, so the node learns nothing of who is near. What the chain says of purposes counts,
        not the registrar's word: a consent withdrawn since the roster was made is no consent.
        """
        rows = list(self._rows.values())
        handles = await _proved(client, key, [b"identity\x00handle/" + row.handle for row in rows])
        members = await _proved(
            client, key, [b"identity\x00member/" + member for member in handles.values() if member is not None]
        )
        confirmed = {}
        for row in rows:
            member = handles[b"identity\x00handle/" + row.handle]
            state = members.get(b"identity\x00member/" + member) if member is not None else None
            if state is not None and _agrees(row, state):
                confirmed[row.tag] = msgspec.structs.replace(row, purposes=tuple(state["purposes"]))
        dropped = len(rows) - len(confirmed)
        self._rows = confirmed
        return dropped


def _agrees(row: RosterRow, state: dict[str, Any]) -> bool:
    told = (row.handle, row.spend, row.view, row.sealing, "active")
    return told == tuple(state[name] for name in ("handle", "spend", "view", "sealing", "status"))


async def _proved(client: NetworkClient, key: PrivateKey, flat_keys: list[bytes]) -> dict[bytes, Any]:
    found: dict[bytes, Any] = {}
    for start in range(0, len(flat_keys), PROOF_KEYS_MAX_COUNT):
        found.update((await client.state_values(flat_keys[start : start + PROOF_KEYS_MAX_COUNT], key)).values)
    return found


def load_roster(path: Path, identity: RobotIdentity, genesis: Genesis, now_ms: int) -> RosterBook:
    """Open a sealed roster. Raises ROSTER_INVALID or ROSTER_EXPIRED."""
    try:
        sealed = path.read_bytes()
    except FileNotFoundError:
        raise BlockRobotError("ROSTER_INVALID", f"There is no roster at {path}.") from None
    registrars = {key for organisation in genesis.organisations for key in organisation.registrars}
    return RosterBook(
        open_roster(
            sealed,
            identity.sealing,
            registrars=registrars,
            now_ms=now_ms,
            robot=identity.identity.public_key,
            chain_id=genesis.chain_id,
        )
    )

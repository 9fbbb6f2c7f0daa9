"""The registrar's desk: issues cards and makes rosters. Must never tell a node, a log or an argument list a tag's UID.

The list of cards (which tag has which handle) is a file at the desk, readable by its user only. Nothing of it leaves
but codes for people to carry away and rosters sealed to one robot.
"""

from __future__ import annotations

import json
import os
import secrets
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import msgspec

from clients.sdk.http import NetworkClient
from clients.sdk.pin_file import PIN_FILE, open_pinned_client
from clients.sdk.transactions import Clock, SystemClock
from consensus.errors import BlockRobotError
from consensus.genesis import Genesis
from consensus.primitives.keys import PrivateKey
from consensus.records.roster import (
    ROSTER_KEY_BYTES,
    ROSTER_LIFETIME_MAX_MS,
    ROSTER_VERSION,
    Roster,
    RosterRow,
    roster_tag,
    seal_roster,
)
from consensus.records.vouchers import encode_card_code, issue_card

CARD_LIFETIME_DEFAULT_MS = 14 * 24 * 3600 * 1000
_CARDS_FILE = "cards.json"
_KEY_FILE = "registrar.key"
_RECORDED_ROLES = ("subject", "staff")


@dataclass(frozen=True, slots=True)
class CardEntry:
    """One card of the list: the tag's UID, the handle it was given (hex), and the role."""

    uid: str
    handle: str
    role: str


class Desk:
    """The desk of one organisation's registrar, in one folder."""

    def __init__(self, folder: Path, genesis: Genesis, clock: Clock | None = None) -> None:
        """Open a desk. Raises DATA_DIRECTORY_INVALID without a registrar's key of this network."""
        self._folder = folder
        self._genesis = genesis
        self._clock = clock or SystemClock()
        try:
            self.key = PrivateKey((folder / _KEY_FILE).read_bytes())
        except FileNotFoundError:
            raise BlockRobotError("DATA_DIRECTORY_INVALID", f"There is no {_KEY_FILE} in {folder}.") from None
        registrars = {key for organisation in genesis.organisations for key in organisation.registrars}
        if self.key.public_key not in registrars:
            raise BlockRobotError("DATA_DIRECTORY_INVALID", "The key is not one of this network's registrars.")

    def cards(self) -> list[CardEntry]:
        """Return all cards that were issued here. Raises DATA_DIRECTORY_INVALID if the list is damaged."""
        path = self._folder / _CARDS_FILE
        if not path.exists():
            return []
        try:
            return msgspec.json.decode(path.read_bytes(), type=list[CardEntry])
        except msgspec.MsgspecError:
            raise BlockRobotError(
                "DATA_DIRECTORY_INVALID", f"The list of cards in {self._folder} is damaged."
            ) from None

    def issue(self, uid: str, role: str, lifetime_ms: int = CARD_LIFETIME_DEFAULT_MS) -> str:
        """Issue a card for a tag and return its enrolment code; a tag that had a card gets a new handle."""
        normal = uid.strip().upper()
        if not normal:
            raise BlockRobotError("REQUEST_INVALID", "The tag's UID is empty.")
        card = issue_card(
            self.key,
            chain_id=self._genesis.chain_id,
            handle=secrets.token_bytes(32),
            card_secret=secrets.token_bytes(32),
            role=role,
            not_after_ms=self._clock.now_ms() + lifetime_ms,
        )
        kept = [entry for entry in self.cards() if entry.uid != normal]
        self._save([*kept, CardEntry(uid=normal, handle=card.handle.hex(), role=role)])
        return encode_card_code(card)

    def _save(self, cards: list[CardEntry]) -> None:
        temporary = self._folder / f".{_CARDS_FILE}.tmp"
        descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        with os.fdopen(descriptor, "w", encoding="utf-8") as file:
            os.fchmod(descriptor, 0o600)  # a leftover of a crash keeps its old mode
            json.dump([asdict(card) for card in cards], file)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(self._folder / _CARDS_FILE)

    async def make_roster(self, robot: bytes) -> tuple[bytes, int]:
        """Return a robot's sealed roster of everyone registered here, and how many rows it has.

        `robot` is its member key M. What stands in the rows is proven against a finalized header. Raises NOT_FOUND if
        the robot is not registered.
        """
        async with open_pinned_client(self._genesis, self._folder / PIN_FILE) as client:
            members = await self._registered(client)
            robot_state = await client.state_value("identity", b"member/" + robot, self.key)
        if robot_state is None or robot_state["role"] != "robot" or robot_state["status"] != "active":
            raise BlockRobotError("NOT_FOUND", "There is no active robot with this key.")
        key = secrets.token_bytes(ROSTER_KEY_BYTES)
        now = self._clock.now_ms()
        roster = Roster(
            version=ROSTER_VERSION,
            chain_id=self._genesis.chain_id,
            robot=robot,
            key=key,
            issued_at_ms=now,
            not_after_ms=now + ROSTER_LIFETIME_MAX_MS,
            rows=tuple(self._row(key, card, state) for card, state in members),
        )
        return seal_roster(roster, self.key, robot_state["sealing"]), len(roster.rows)

    async def _registered(self, client: NetworkClient) -> list[tuple[CardEntry, dict[str, Any]]]:
        found = []
        for card in self.cards():
            if card.role not in _RECORDED_ROLES:
                continue
            member = await client.state_value("identity", b"handle/" + bytes.fromhex(card.handle), self.key)
            if member is None:
                continue
            state = await client.state_value("identity", b"member/" + member, self.key)
            if state is not None and state["status"] == "active":
                found.append((card, state))
        return found

    @staticmethod
    def _row(key: bytes, card: CardEntry, state: dict[str, Any]) -> RosterRow:
        return RosterRow(
            tag=roster_tag(key, card.uid),
            handle=bytes.fromhex(card.handle),
            spend=state["spend"],
            view=state["view"],
            sealing=state["sealing"],
            proof=b"",
        )

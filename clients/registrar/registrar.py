"""The registrar's cards and rosters. The tag-to-handle list stays local, user-only; only codes and robot-sealed
rosters leave it.
"""

from __future__ import annotations

import json
import secrets
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

from clients.sdk.chain.proved_rows import Read, in_session, proved_row, put_query
from clients.sdk.chain.transactions import Clock, SystemClock
from clients.sdk.network_client import NetworkClient, open_pinned_client
from clients.sdk.new_files import replace_file
from clients.sdk.trust_pin import PIN_FILE
from consensus.bounded_text import TextInvalidError, read_json_as
from consensus.chain.genesis import Genesis
from consensus.errors import BlockRobotError
from consensus.members.roster import (
    ROSTER_KEY_BYTES,
    ROSTER_LIFETIME_MAX_MS,
    ROSTER_VERSION,
    Roster,
    RosterRow,
    roster_tag,
    seal_roster,
)
from consensus.members.vouchers import encode_card_code, issue_card
from consensus.primitives.keys import PrivateKey
from consensus.state.identity import HANDLE, MEMBER, REGISTRAR, MemberRow, member_with

CARD_LIFETIME_DEFAULT_MS = 14 * 24 * 3600 * 1000
_CARDS_FILE = "cards.json"
KEY_FILE = "registrar.key"
_RECORDED_ROLES = ("subject", "staff")


@dataclass(frozen=True, slots=True)
class CardEntry:
    """One card: tag UID, handle (hex), role, and code expiry. `superseded`: the tag got another card since."""

    uid: str
    handle: str
    role: str
    not_after_ms: int
    superseded: bool = False


@dataclass(frozen=True, slots=True)
class SealedRoster:
    """A roster for one robot; `superseded` members are not on it: their tag got another card."""

    sealed: bytes
    rows: int
    superseded: tuple[bytes, ...]


@dataclass(frozen=True, slots=True)
class Revoked:
    """A membership that the registrar ended: transaction and role."""

    txid: bytes
    role: str


class Registrar:
    """One organisation's registrar: a folder with a key and a list of cards."""

    def __init__(self, folder: Path, genesis: Genesis, clock: Clock | None = None) -> None:
        """Raises ORGANISATION_KEY_NOT_FOUND without a key."""
        self._folder = folder
        self._genesis = genesis
        self._clock = clock or SystemClock()
        try:
            self.key = PrivateKey((folder / KEY_FILE).read_bytes())
        except FileNotFoundError:
            raise BlockRobotError("ORGANISATION_KEY_NOT_FOUND", f"There is no {KEY_FILE} in {folder}.") from None

    async def find_organisation(self) -> str:
        """Return whose registrar this is, by the genesis file or, for a later one, by the chain.

        Raises DATA_DIRECTORY_INVALID for a key that is no registrar's.
        """
        own = self.key.public_key
        for organisation in self._genesis.organisations:
            if own in organisation.registrars:
                return organisation.name
        try:
            async with open_pinned_client(self._genesis, self._folder / PIN_FILE) as client:
                found = await proved_row(self._read(client), REGISTRAR, own)
        except BlockRobotError as error:
            if error.code != "SESSION_REFUSED":
                raise
            found = None
        if found is None:
            raise BlockRobotError("DATA_DIRECTORY_INVALID", "The key is not one of this network's registrars.")
        return found

    def cards(self) -> list[CardEntry]:
        """Raises DATA_DIRECTORY_INVALID if the list is damaged."""
        path = self._folder / _CARDS_FILE
        if not path.exists():
            return []
        try:
            return read_json_as(path.read_bytes(), list[CardEntry])
        except TextInvalidError:
            raise BlockRobotError(
                "DATA_DIRECTORY_INVALID", f"The list of cards in {self._folder} is damaged."
            ) from None

    def issue(self, uid: str, role: str, lifetime_ms: int = CARD_LIFETIME_DEFAULT_MS) -> str:
        """Return an enrolment code, with a new handle per card."""
        normal = uid.strip().upper()
        if not normal:
            raise BlockRobotError("REQUEST_INVALID", "The tag's UID is empty.")
        not_after_ms = self._clock.now_ms() + lifetime_ms
        card = issue_card(
            self.key,
            chain_id=self._genesis.chain_id,
            handle=secrets.token_bytes(32),
            card_secret=secrets.token_bytes(32),
            role=role,
            not_after_ms=not_after_ms,
        )
        # A superseded card still registers, as the chain knows no card before: who does so has to be found.
        kept = [replace(entry, superseded=True) if entry.uid == normal else entry for entry in self.cards()]
        self._save([*kept, CardEntry(normal, card.handle.hex(), role, not_after_ms)])
        return encode_card_code(card)

    def has_card(self, uid: str) -> bool:
        return any(entry.uid == uid.strip().upper() for entry in self.cards())

    def forget(self, uid: str) -> int:
        normal = uid.strip().upper()
        cards = self.cards()
        kept = [entry for entry in cards if entry.uid != normal]
        if len(kept) < len(cards):
            self._save(kept)
        return len(cards) - len(kept)

    async def forget_former(self) -> int:
        """Remove ended memberships and expired codes; return how many."""
        async with open_pinned_client(self._genesis, self._folder / PIN_FILE) as client:
            return self._keep(await self._states(client))

    def _keep(self, states: list[tuple[CardEntry, MemberRow | None]]) -> int:
        now = self._clock.now_ms()
        gone = {
            card.handle for card, state in states if (card.not_after_ms < now if state is None else not state.is_active)
        }
        if gone:
            self._save([card for card in self.cards() if card.handle not in gone])
        return len(gone)

    async def get_member(self, uid: str) -> bytes:
        """Raises NOT_FOUND."""
        normal = uid.strip().upper()
        handles = [card.handle for card in self.cards() if card.uid == normal and not card.superseded]
        async with open_pinned_client(self._genesis, self._folder / PIN_FILE) as client:
            for handle in handles:
                found = await proved_row(self._read(client), HANDLE, bytes.fromhex(handle))
                if found is not None:
                    return found
        raise BlockRobotError("NOT_FOUND", "No card of this tag registered anybody.")

    async def get_role(self, member: bytes) -> str:
        """Return an active member's proved role. Raises NOT_FOUND."""
        async with open_pinned_client(self._genesis, self._folder / PIN_FILE) as client:
            return (await self._active(client, member)).role

    async def revoke(self, member: bytes) -> Revoked:
        """End a membership and remove its card. Raises NOT_FOUND, CALL_REFUSED."""
        async with open_pinned_client(self._genesis, self._folder / PIN_FILE) as client:
            state = await self._active(client, member)
            receipt = await client.call(self.key, "identity", "revoke", [state.handle])
        self._save([card for card in self.cards() if card.handle != state.handle.hex()])
        return Revoked(receipt.txid, state.role)

    async def name_robot(self, robot: bytes, name: str, place: str) -> bytes:
        """Raises NOT_FOUND, CALL_REFUSED."""
        async with open_pinned_client(self._genesis, self._folder / PIN_FILE) as client:
            state = await self._active(client, robot)
            receipt = await client.call(self.key, "identity", "name_robot", [state.handle, name, place])
        return receipt.txid

    def _read(self, client: NetworkClient) -> Read:
        return in_session(client, self.key)

    async def _active(self, client: NetworkClient, member: bytes) -> MemberRow:
        state = await proved_row(self._read(client), MEMBER, member)
        if state is None or not state.is_active:
            raise BlockRobotError("NOT_FOUND", "There is no active member with this key.")
        return state

    def _save(self, cards: list[CardEntry]) -> None:
        content = json.dumps([asdict(card) for card in cards]).encode()
        replace_file(self._folder / _CARDS_FILE, content, temporary=self._folder / f".{_CARDS_FILE}.tmp")

    async def make_roster(self, robot: bytes) -> SealedRoster:
        """Seal a proven roster for a robot (key M); forget former members. Raises NOT_FOUND."""
        async with open_pinned_client(self._genesis, self._folder / PIN_FILE) as client:
            states = await self._states(client)
            robot_state = await proved_row(self._read(client), MEMBER, robot)
            recorded = [
                (card, state)
                for card, state in states
                if state is not None and state.is_active and card.role in _RECORDED_ROLES
            ]
            superseded = [bytes.fromhex(card.handle) for card, _ in recorded if card.superseded]
            found: list[bytes] = []
            for handle in superseded:
                member = await proved_row(self._read(client), HANDLE, handle)
                found += [] if member is None else [member]
        if robot_state is None or robot_state.role != "robot" or not robot_state.is_active:
            raise BlockRobotError("NOT_FOUND", "There is no active robot with this key.")
        self._keep(states)
        members = [(card, state) for card, state in recorded if not card.superseded]
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
        sealed = seal_roster(roster, self.key, robot_state.sealing)
        return SealedRoster(sealed, len(roster.rows), tuple(found))

    async def _states(self, client: NetworkClient) -> list[tuple[CardEntry, MemberRow | None]]:
        read = self._read(client)
        handles = [(card, bytes.fromhex(card.handle)) for card in self.cards()]
        return [(card, await put_query(read, partial(member_with, handle=handle))) for card, handle in handles]

    @staticmethod
    def _row(key: bytes, card: CardEntry, state: MemberRow) -> RosterRow:
        return RosterRow(
            tag=roster_tag(key, card.uid),
            handle=bytes.fromhex(card.handle),
            spend=state.spend,
            view=state.view,
            sealing=state.sealing,
            proof=b"",
        )

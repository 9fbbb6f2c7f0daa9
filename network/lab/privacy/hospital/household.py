"""Keys and enrolment of people and robots in the attacked hospital."""

from __future__ import annotations

import secrets
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from clients.robot.identity.robot_keys import RobotIdentity, create_identity
from clients.robot.pairing.rosters import RosterBook, load_roster
from clients.wallet.store.member_keys import WalletKeys, derive_keys, draw_words
from consensus.members.roster import (
    ROSTER_KEY_BYTES,
    ROSTER_LIFETIME_MAX_MS,
    ROSTER_VERSION,
    Roster,
    RosterRow,
    roster_tag,
    seal_roster,
)
from consensus.members.vouchers import issue_card, sign_card
from consensus.primitives.keys import PrivateKey
from network.lab.privacy.hospital.attacked_chain import Chain
from network.lab.privacy.hospital.population import Person

PURPOSE = "care"
_CARD_LIFETIME_MS = 14 * 24 * 3_600_000


@dataclass(frozen=True, slots=True)
class Holder:
    """A person with wallet keys and card handle."""

    person: Person
    keys: WalletKeys
    handle: bytes

    @property
    def public_keys(self) -> tuple[bytes, bytes, bytes]:
        return self.keys.identity.public_key, self.keys.spend.public_key, self.keys.view.public_key


@dataclass(frozen=True, slots=True)
class Unit:
    """A robot: folder, keys, member key."""

    number: int
    folder: Path
    identity: RobotIdentity

    @property
    def member(self) -> bytes:
        return self.identity.identity.public_key


def make_holder(person: Person) -> Holder:
    return Holder(person, derive_keys(draw_words()), secrets.token_bytes(32))


def make_unit(number: int, folder: Path) -> Unit:
    return Unit(number, folder, create_identity(folder))


async def register(
    chain: Chain, handle: bytes, role: str, identity: PrivateKey, publics: tuple[bytes, bytes, bytes]
) -> None:
    card = issue_card(
        chain.registrar,
        chain_id=chain.chain_id,
        handle=handle,
        card_secret=secrets.token_bytes(32),
        role=role,
        not_after_ms=chain.now_ms() + _CARD_LIFETIME_MS,
    )
    spend, view, sealing = publics
    signature = sign_card(
        card, chain_id=chain.chain_id, member=identity.public_key, spend=spend, view=view, sealing=sealing
    )
    arguments: list[Any] = [card.handle, card.card_public, role, card.not_after_ms, card.voucher_signature]
    arguments += [spend, view, sealing, signature, [PURPOSE] if role == "subject" else []]
    final = await chain.submit(chain.sign(identity, "identity", "register", arguments))
    if not final.ok:
        raise AssertionError(f"the chain refused a registration: {final.code}")


def publics_of(keys: WalletKeys | RobotIdentity) -> tuple[bytes, bytes, bytes]:
    return keys.spend.public_key, keys.view.public_key, keys.sealing_public


def make_roster(chain: Chain, unit: Unit, holders: list[Holder]) -> RosterBook:
    key, now_ms = secrets.token_bytes(ROSTER_KEY_BYTES), chain.now_ms()
    rows = []
    for holder in holders:
        spend, view, sealing = publics_of(holder.keys)
        tag = roster_tag(key, holder.person.uid)
        rows.append(RosterRow(tag=tag, handle=holder.handle, spend=spend, view=view, sealing=sealing, proof=b""))
    roster = Roster(
        version=ROSTER_VERSION,
        chain_id=chain.chain_id,
        robot=unit.member,
        key=key,
        issued_at_ms=now_ms,
        not_after_ms=now_ms + ROSTER_LIFETIME_MAX_MS,
        rows=tuple(rows),
    )
    path = unit.folder / "roster"
    path.write_bytes(seal_roster(roster, chain.registrar, unit.identity.sealing_public))
    return load_roster(path, unit.identity, chain.chain_id, now_ms)

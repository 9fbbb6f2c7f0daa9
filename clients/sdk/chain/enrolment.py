"""Member registration with a card's code, for wallet and robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from clients.sdk.chain.proved_rows import in_session, proved_row
from clients.sdk.network_client import FinalReceipt, NetworkClient
from consensus.errors import BlockRobotError
from consensus.members.vouchers import Card, sign_card
from consensus.primitives.keys import PrivateKey
from consensus.state.identity import HANDLE, MEMBER, MemberRow


@dataclass(frozen=True, slots=True)
class NewMember:
    """A registrant's keys: M private; S, V (33 bytes) and X (32 bytes) public."""

    identity: PrivateKey
    spend: bytes
    view: bytes
    sealing: bytes


@dataclass(frozen=True, slots=True)
class Registration:
    """A final registration and the member key (33 bytes). `txid` is empty if registered before."""

    txid: bytes
    member: bytes
    receipt: FinalReceipt | None = None


def registration_arguments(card: Card, member: NewMember, chain_id: bytes, purposes: list[str]) -> list[Any]:
    """Of `identity.register`, bound to the keys by the card."""
    signature = sign_card(
        card,
        chain_id=chain_id,
        member=member.identity.public_key,
        spend=member.spend,
        view=member.view,
        sealing=member.sealing,
    )
    return [
        card.handle,
        card.card_public,
        card.role,
        card.not_after_ms,
        card.voucher_signature,
        member.spend,
        member.view,
        member.sealing,
        signature,
        purposes,
    ]


async def find_registration(client: NetworkClient, identity: PrivateKey) -> MemberRow | None:
    """Proved; None if no active member's."""
    try:
        found = await proved_row(in_session(client, identity), MEMBER, identity.public_key)
    except BlockRobotError as error:
        if error.code != "SESSION_REFUSED":
            raise
        return None
    return found if found is not None and found.is_active else None


async def register_member(client: NetworkClient, card: Card, member: NewMember, purposes: list[str]) -> Registration:
    """Register and check that the handle maps to M; idempotent. Raises CALL_REFUSED, PROOF_INVALID."""
    known = await find_registration(client, member.identity)
    if known is not None and known.handle == card.handle:
        return Registration(txid=b"", member=member.identity.public_key)
    arguments = registration_arguments(card, member, client.genesis.chain_id, purposes)
    receipt = await client.call(member.identity, "identity", "register", arguments)
    recovered = await proved_row(in_session(client, member.identity), HANDLE, card.handle)
    if recovered != member.identity.public_key:
        raise BlockRobotError("PROOF_INVALID", "The chain does not map the card's handle to this key.")
    return Registration(txid=receipt.txid, member=recovered, receipt=receipt)

"""Grants as the chain has them: read, proved complete, and found by the grantee. Must never trust a node with the list.

Every grantee reads every grant in her member session, so that a node learns nothing of which are hers; what concerns
one grant is asked in the session of that grant's key.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from clients.sdk.connections import NodeAddress
from clients.sdk.sessions import GrantKey
from clients.wallet import naming
from clients.wallet.auditing import AuditEntry
from clients.wallet.keys import WalletKeys
from clients.wallet.naming import find_named
from clients.wallet.sharing_memory import ReceivedGrant
from clients.wallet.wallet import Wallet
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import u64
from consensus.primitives.keys import PrivateKey
from consensus.records.grant_keys import derive_grant_salt
from consensus.records.sharing import derive_grantee_key, scan_grant

GRANT = b"access\x00grant/"
_COUNT = b"access\x00grant-count"
_NUMBER = b"access\x00grant-number/"
_CUSTODIANS = b"identity\x00custodians"
_CUSTODIAN = b"identity\x00custodian/"
PAGE_COUNT = 100


@dataclass(frozen=True, slots=True)
class Grant:
    """One grant, proven: of which visit (its owner key), which records, for whom (one-time key), why, until when (ms)."""

    grant_id: bytes
    owner: bytes
    records: tuple[bytes, ...]
    grantee: bytes
    ephemeral: bytes
    view_tag: int
    member_hash: bytes
    purpose: str
    until_ms: int
    time_ms: int
    status: str
    noticed: frozenset[bytes]

    def is_open(self, now_ms: int) -> bool:
        """Whether it was not revoked, and its time is not over."""
        return self.status == "active" and now_ms < self.until_ms


def read_grant(grant_id: bytes, state: Any) -> Grant:
    """Return a grant from its proved state. Raises PROOF_INVALID for what is none."""
    try:
        return Grant(
            grant_id=grant_id,
            owner=state["owner"],
            records=tuple(state["records"]),
            grantee=state["grantee"],
            ephemeral=state["ephemeral"],
            view_tag=state["view_tag"],
            member_hash=state["member_hash"],
            purpose=state["purpose"],
            until_ms=state["until_ms"],
            time_ms=state["time"],
            status=state["status"],
            noticed=frozenset(state["noticed"]),
        )
    except (KeyError, TypeError):
        raise BlockRobotError(
            "PROOF_INVALID", f"What the chain has of grant {grant_id.hex()[:12]} is no grant."
        ) from None


async def read_grants(wallet: Wallet, ids: Sequence[bytes], session: PrivateKey) -> list[Grant]:
    """Return grants by their ids, proven, in one session; an id that the chain does not know is left out."""
    values = await wallet.values([GRANT + grant_id for grant_id in ids], session)
    return [read_grant(grant_id, values[GRANT + grant_id]) for grant_id in ids if values[GRANT + grant_id] is not None]


async def read_custodians(wallet: Wallet, session: PrivateKey) -> dict[bytes, NodeAddress | None]:
    """Return the custodians by key, as the chain proves them; None for one whose address this wallet lacks."""
    keys: list[bytes] = (await wallet.values([_CUSTODIANS], session))[_CUSTODIANS] or []
    names = await wallet.values([_CUSTODIAN + key for key in keys], session) if keys else {}
    addresses = {node.name: node for node in wallet.network.custody.custodians}
    return {key: addresses.get(names[_CUSTODIAN + key]["name"]) for key in keys}


async def _read_page(wallet: Wallet, first: int) -> tuple[int, list[Grant]]:
    """Return how many grants there are in all, and those from number `first` on, at most a page, none left out."""
    session = wallet.keys.identity
    numbers = {number: _NUMBER + u64(number) for number in range(first, first + PAGE_COUNT)}
    values = await wallet.values([_COUNT, *numbers.values()], session)
    count = values[_COUNT] or 0
    ids = [values[key] for number, key in numbers.items() if number < count]
    grants = [] if None in ids else await read_grants(wallet, ids, session)
    if len(grants) != len(ids):
        raise BlockRobotError("PROOF_INVALID", "The page leaves grants out.")
    return count, grants


async def find_received(wallet: Wallet) -> tuple[list[ReceivedGrant], bool]:
    """Read the grants that are new since last time; return all that are for this wallet, and whether new ones were read.

    Who has left, or whose membership was ended, reads no more grants and has what she knew: copies may have to go after
    that too. Raises PROOF_INVALID if one is left out, NOT_REGISTERED.
    """
    await wallet.require_registered()
    content, known_count = wallet.store.content, wallet.store.content.scanned_grants_count
    while True:
        try:
            count, grants = await _read_page(wallet, content.scanned_grants_count)
        except BlockRobotError as error:
            if error.code != "SESSION_REFUSED":
                raise
            return list(content.received_grants), False
        for grant in grants:
            for era, keys in enumerate(wallet.eras):
                if is_for(grant, keys, wallet.genesis.chain_id):
                    content.received_grants.append(ReceivedGrant(grant.grant_id, grant.owner, grant.ephemeral, era))
        content.scanned_grants_count += len(grants)
        if content.scanned_grants_count >= count:
            break
    if content.scanned_grants_count != known_count:
        wallet.store.save()
    return list(content.received_grants), True


def is_for(grant: Grant, keys: WalletKeys, chain_id: bytes) -> bool:
    """Tell whether a grant is for these keys. The view tag spares most of the work."""
    found = scan_grant(
        keys.view, keys.spend.public_key, grant.ephemeral, grant.view_tag, chain_id=chain_id, owner=grant.owner
    )
    return found == grant.grantee


def grantee_key(received: ReceivedGrant, wallet: Wallet) -> GrantKey:
    """Derive the private key of a grant, to be used as its. It is never stored and never leaves this process."""
    keys = wallet.eras[received.era]
    key = derive_grantee_key(
        keys.spend, keys.view, received.ephemeral, chain_id=wallet.genesis.chain_id, owner=received.owner
    )
    return GrantKey(key, received.grant_id)


def grantee_salt(received: ReceivedGrant, wallet: Wallet) -> bytes:
    """Derive the salt that shows custodians for whose handle a grant is."""
    chain_id = wallet.genesis.chain_id
    return derive_grant_salt(
        wallet.eras[received.era].view, received.ephemeral, chain_id=chain_id, owner=received.owner
    )


def find_by_prefix(ids: Sequence[bytes], start: str) -> bytes:
    """Return the one grant id that begins so (hexadecimal). Raises GRANT_NOT_FOUND, NAME_TOO_SHORT, NAME_AMBIGUOUS."""
    return ids[find_named(naming.GRANT, [grant_id.hex() for grant_id in ids], start)]


def cut_since(grant: Grant, trail: Sequence[AuditEntry]) -> set[bytes]:
    """Return the records of which single pictures were asked to be erased after the grant, by the visit's trail.

    The record itself tells it only once every custodian has confirmed; those that work destroy their parts at once.
    """
    asked = (entry for entry in trail if entry.kind == "erasure_requested" and entry.data["frames"])
    return {entry.record_id for entry in asked if entry.time_ms >= grant.time_ms}

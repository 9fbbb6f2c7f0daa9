"""Reads and proves grants; grantees read all in their member session, hiding their own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from clients.sdk.chain.proved_rows import proved_rows, put_query
from clients.sdk.connections import NodeAddress
from clients.sdk.sessions import GrantKey
from clients.wallet.ledger import id_prefix
from clients.wallet.ledger.id_prefix import resolve_id_prefix
from clients.wallet.ledger.visit_audit import AuditEntry
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.store.keystore import ReceivedGrant
from clients.wallet.store.member_keys import WalletKeys
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from consensus.records.sharing import derive_grant_salt, derive_grantee_key, scan_grant
from consensus.state.access import GRANT, GRANT_COUNT, GRANT_NUMBER, GrantRow
from consensus.state.identity import CUSTODIAN, custodians

PAGE_COUNT = 100


@dataclass(frozen=True, slots=True)
class Grant:
    """One grant as the chain proves it."""

    grant_id: bytes
    row: GrantRow


async def read_grants(wallet: Wallet, ids: Sequence[bytes], session: PrivateKey) -> list[Grant]:
    values = await wallet.values([GRANT.key(grant_id) for grant_id in ids], session)
    rows = [(grant_id, GRANT.among(values, grant_id)) for grant_id in ids]
    return [Grant(grant_id, row) for grant_id, row in rows if row is not None]


async def read_custodians(wallet: Wallet, session: PrivateKey) -> dict[bytes, NodeAddress | None]:
    read = wallet.reading(session)
    keys = await put_query(read, custodians)
    rows = await proved_rows(read, CUSTODIAN, keys)
    addresses = {node.name: node for node in wallet.network.custody.custodians}
    return {key: addresses.get(row.name) for key, row in zip(keys, rows, strict=True)}


async def _read_page(wallet: Wallet, first: int) -> tuple[int, list[Grant]]:
    session = wallet.keys.identity
    numbers = range(first, first + PAGE_COUNT)
    values = await wallet.values([GRANT_COUNT.flat, *map(GRANT_NUMBER.key, numbers)], session)
    count = GRANT_COUNT.among(values) or 0
    ids = [values[GRANT_NUMBER.key(number)] for number in numbers if number < count]
    grants = [] if None in ids else await read_grants(wallet, ids, session)
    if len(grants) != len(ids):
        raise BlockRobotError("PROOF_INVALID", "The page leaves grants out.")
    return count, grants


async def find_received(wallet: Wallet) -> tuple[list[ReceivedGrant], bool]:
    """Read new grants; return all for this wallet and whether new ones were readable.

    Former members read no new ones. Raises PROOF_INVALID if one is omitted, NOT_REGISTERED.
    """
    await wallet.require_registered()
    content, saved_count = wallet.store.content, wallet.store.content.scanned_grants_count
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
                    content.received_grants.append(
                        ReceivedGrant(grant.grant_id, grant.row.owner, grant.row.ephemeral, era)
                    )
        content.scanned_grants_count += len(grants)
        if content.scanned_grants_count >= count:
            break
        saved_count = wallet.save_scanned(content.scanned_grants_count, count, saved_count)
    if content.scanned_grants_count != saved_count:
        wallet.store.save()
    return list(content.received_grants), True


def is_for(grant: Grant, keys: WalletKeys, chain_id: bytes) -> bool:
    """Compare the view tag first: it is cheap."""
    row = grant.row
    found = scan_grant(
        keys.view, keys.spend.public_key, row.ephemeral, row.view_tag, chain_id=chain_id, owner=row.owner
    )
    return found == row.grantee


def grantee_key(received: ReceivedGrant, wallet: Wallet) -> GrantKey:
    """Derived, neither stored nor sent."""
    keys = wallet.eras[received.era]
    key = derive_grantee_key(
        keys.spend, keys.view, received.ephemeral, chain_id=wallet.genesis.chain_id, owner=received.owner
    )
    return GrantKey(key, received.grant_id)


def grantee_salt(received: ReceivedGrant, wallet: Wallet) -> bytes:
    chain_id = wallet.genesis.chain_id
    return derive_grant_salt(
        wallet.eras[received.era].view, received.ephemeral, chain_id=chain_id, owner=received.owner
    )


def resolve_grant(ids: Sequence[bytes], start: str) -> bytes:
    """By hex prefix. Raises GRANT_NOT_FOUND, NAME_TOO_SHORT, NAME_AMBIGUOUS."""
    return ids[resolve_id_prefix(id_prefix.GRANT, [grant_id.hex() for grant_id in ids], start)]


def cut_since(grant: Grant, trail: Sequence[AuditEntry]) -> set[bytes]:
    asked = (entry for entry in trail if entry.kind == "erasure_requested" and entry.data["frames"])
    return {entry.record_id for entry in asked if entry.time_ms >= grant.row.time}

"""Find own visits with the view key. Wallets read every announcement, so nodes learn nothing."""

from __future__ import annotations

from collections.abc import Sequence

from clients.sdk.chain.announcements import Announcement
from clients.wallet.ledger.id_prefix import RECORD, resolve_id_prefix
from clients.wallet.store.keystore import KnownVisit
from clients.wallet.store.member_keys import WalletKeys
from consensus.primitives.keys import PrivateKey
from consensus.records.owner_keys import derive_owner_key, scan_announcement


def find_own_visits(
    announcements: Sequence[Announcement], keys: WalletKeys, chain_id: bytes, era: int = 0
) -> list[KnownVisit]:
    """Prefiltered by view tag. `era` is the mnemonic's index."""
    found = []
    for item in announcements:
        owner = scan_announcement(
            keys.view, keys.spend.public_key, item.ephemeral, item.view_tag, chain_id=chain_id, robot=item.robot
        )
        if owner == item.owner:
            found.append(
                KnownVisit(
                    owner=item.root or item.owner,
                    ephemeral=item.ephemeral,
                    robot=item.robot,
                    sequence=item.number,
                    bucket_ms=item.bucket_ms,
                    current=item.owner if item.root else b"",
                    era=era,
                )
            )
    return found


def follow_announcements(
    visits: list[KnownVisit], announcements: Sequence[Announcement], eras: Sequence[WalletKeys], chain_id: bytes
) -> None:
    """Merge ordered announcements into `visits`; idempotent. Transferred visits stay in place; those leading to no key
    of `eras` (oldest first) become taken.
    """
    own = {
        found.current or found.owner: found
        for era, keys in enumerate(eras)
        for found in find_own_visits(announcements, keys, chain_id, era)
    }
    places = {visit.owner: place for place, visit in enumerate(visits)}
    for item in announcements:
        name = item.root or item.owner
        found, place = own.get(item.owner), places.get(name)
        if found is None:
            if item.root and place is not None:
                visits[place].taken = True
        elif place is None:
            places[name] = len(visits)
            visits.append(found)
        elif item.root:
            found.sequence, found.shares_due = visits[place].sequence, visits[place].shares_due
            visits[place] = found


def owner_key(visit: KnownVisit, keys: WalletKeys, chain_id: bytes) -> PrivateKey:
    """The key is derived, and never stored."""
    return derive_owner_key(keys.spend, keys.view, visit.ephemeral, chain_id=chain_id, robot=visit.robot)


def resolve_record(known: list[str], wanted: str) -> str:
    """Raises RECORD_NOT_FOUND, NAME_AMBIGUOUS, NAME_TOO_SHORT."""
    return known[resolve_id_prefix(RECORD, known, wanted)]

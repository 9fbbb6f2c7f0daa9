"""Finds a person's visits on the chain, with her view key, without telling anyone which they are.

Every wallet reads every announcement, so a node learns nothing from the reading. Must never ask a node about one visit in
the session of the person's member key: that would join the two.
"""

from __future__ import annotations

from collections.abc import Sequence

from clients.sdk.announcements import Announcement
from clients.wallet.keys import WalletKeys
from clients.wallet.keystore import KnownVisit
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from consensus.records.owner_keys import derive_owner_key, scan_announcement


def find_own_visits(announcements: Sequence[Announcement], keys: WalletKeys, chain_id: bytes) -> list[KnownVisit]:
    """Return the visits among `announcements` that belong to these keys. The view tag spares most of the work."""
    found = []
    for item in announcements:
        owner = scan_announcement(
            keys.view, keys.spend.public_key, item.ephemeral, item.view_tag, chain_id=chain_id, robot=item.robot
        )
        if owner == item.owner:
            found.append(
                KnownVisit(
                    owner=item.owner,
                    ephemeral=item.ephemeral,
                    robot=item.robot,
                    sequence=item.number,
                    bucket_ms=item.bucket_ms,
                )
            )
    return found


def owner_key(visit: KnownVisit, keys: WalletKeys, chain_id: bytes) -> PrivateKey:
    """Derive the visit's private owner key o. It is never stored and never leaves this process."""
    return derive_owner_key(keys.spend, keys.view, visit.ephemeral, chain_id=chain_id, robot=visit.robot)


def find_record(known: list[str], wanted: str) -> str:
    """Return the one record whose id begins so. Raises NOT_FOUND if there is none, or more than one."""
    found = [record_id for record_id in known if wanted and record_id.startswith(wanted.lower())]
    if len(found) != 1:
        several = "more than one record whose id begins with" if found else "no record"
        raise BlockRobotError("NOT_FOUND", f"You have {several} {wanted}.")
    return found[0]

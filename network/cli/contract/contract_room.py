"""Checks before a source upload whether its proposal has room.

Contracts decide, but an upload evicts the oldest one even if the proposal is refused.
"""

from __future__ import annotations

from clients.sdk.chain.governance import MembershipView, ProposalRow
from clients.sdk.network_client import NetworkClient
from consensus.errors import BlockRobotError
from consensus.state.identity import ADMIN
from consensus.state.lifecycle import UPLOADS
from network.cli.governance.governance_signer import GovernanceSigner, command_group, shown_id, summary_of

OPEN_OF_ONE_MAX_COUNT = 4
UPLOADS_MAX_COUNT = 4


async def require_room(
    client: NetworkClient, seat: GovernanceSigner, membership: MembershipView, source_hash: bytes
) -> None:
    """Refuse uploads without room or evicting another's source. Raises GOVERNANCE_PROPOSALS_TOO_MANY."""
    admin_key = ADMIN.key(seat.key.public_key)
    organisation = (await client.state_values([admin_key], seat.key)).values[admin_key] or seat.organisation
    own = [row for row in membership.proposals if row.organisation == organisation]
    if len(own) >= OPEN_OF_ONE_MAX_COUNT:
        oldest = min(own, key=lambda row: row.height)
        text = f"{organisation} has {len(own)} open proposals, and more than {OPEN_OF_ONE_MAX_COUNT} it may not have."
        raise BlockRobotError("GOVERNANCE_PROPOSALS_TOO_MANY", f"{text} {_way_out(oldest, organisation)}")
    place = UPLOADS.key(organisation)
    uploads = (await client.state_values([place], seat.key)).values[place] or []
    hashes = [entry["source_hash"] for entry in uploads]
    if source_hash in hashes or len(hashes) < UPLOADS_MAX_COUNT:
        return
    for row in own:
        if (row.contract, row.kind) == ("lifecycle", "deploy") and row.arguments["source_hash"] == hashes[0]:
            text = f"The upload would push out the source of {organisation}'s open proposal {shown_id(row.id)}."
            raise BlockRobotError("GOVERNANCE_PROPOSALS_TOO_MANY", f"{text} {_way_out(row, organisation)}")


def _way_out(row: ProposalRow, organisation: str) -> str:
    command = f"blockrobot {command_group(row.contract)} withdraw {shown_id(row.id)} --as {organisation}"
    return f"Take one back, such as {summary_of(row)}: {command}"

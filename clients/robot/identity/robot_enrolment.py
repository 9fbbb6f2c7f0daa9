"""Registers a robot with a registrar's code."""

from __future__ import annotations

from pathlib import Path

from clients.robot.identity.robot_keys import RobotIdentity
from clients.sdk.chain.enrolment import NewMember, Registration, register_member
from clients.sdk.trust_pin_file import PIN_FILE, open_pinned_client
from consensus.chain.genesis import Genesis
from consensus.members.vouchers import decode_card_code


async def register_robot(folder: Path, identity: RobotIdentity, code: str, genesis: Genesis) -> Registration:
    """Raises VOUCHER_INVALID, CALL_REFUSED."""
    card = decode_card_code(code)
    member = NewMember(
        identity=identity.identity,
        spend=identity.spend.public_key,
        view=identity.view.public_key,
        sealing=identity.sealing_public,
    )
    async with open_pinned_client(genesis, folder / PIN_FILE) as client:
        return await register_member(client, card, member, [])

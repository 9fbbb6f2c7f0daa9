"""Robots' proven names, given by their organisation."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from clients.wallet.ledger.wallet import Wallet
from clients.wallet.store.keystore import KnownVisit
from consensus.state.identity import ROBOT_NAME, RobotName, read_robot_name

KEY_SHOWN_CHARS = 10
RobotNames = Mapping[bytes, RobotName]


async def read_robot_names(wallet: Wallet, visits: Iterable[KnownVisit]) -> dict[bytes, RobotName]:
    """Robots without a name are left out."""
    found = {}
    # Each robot in the session of a visit of its own: asked together, a node would learn that one person met them all.
    for robot, visit in {visit.robot: visit for visit in visits}.items():
        key = ROBOT_NAME.key(robot)
        named = read_robot_name((await wallet.values([key], wallet.owner_key(visit)))[key])
        if named is not None:
            found[robot] = named
    return found


def robot_label(robot: bytes, names: RobotNames) -> str:
    """Name, place and key prefix, or only the prefix."""
    key, named = robot.hex()[:KEY_SHOWN_CHARS], names.get(robot)
    if named is None:
        return key
    return f"{named.name} ({named.place}; {key})" if named.place else f"{named.name} ({key})"

"""A registry in a dict: the chain's identities and consents, with heights and times, which can be cut off."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import Any

from clients.robot.consent.consent_view import STALE_AFTER_MS, Consents
from clients.robot.consent.registry_reader import RegistryReader
from clients.robot.pairing.rosters import RosterBook
from clients.sdk.proof_checks import ProvedState
from consensus.errors import BlockRobotError
from consensus.members.roster import Roster
from consensus.primitives.keys import PrivateKey
from consensus.state import consent, identity
from consensus.state.consent import CHOICES
from consensus.state.identity import HANDLE, MEMBER, REGISTRAR, MemberRow
from consensus.state.keys import to_value

ROBOT = PrivateKey(bytes([5] * 32))
SIGNER = PrivateKey(bytes([6] * 32)).public_key
PERSON_KEY = bytes(range(32))


class RegistryStandIn:
    """Answers as `NetworkClient` would. Each word of a person is a block of its own, at the clock's time."""

    def __init__(self, roster: Roster, now_ms: Callable[[], int]) -> None:
        self.now_ms = now_ms
        self.height = 10
        self.time_ms = now_ms() - 1_000
        self.failure = ""
        self.asked: list[bytes] = []
        self.caught_up = 0
        self.idle = False
        self.cut_off = False
        self.others_serve = False
        self.quorums_asked = 0
        robot = MemberRow(bytes(32), "robot", "ward", b"", b"", b"", "active", 0)
        self.state: dict[bytes, Any] = {
            identity.CHANGES.flat: 1,
            consent.CHANGES.flat: 1,
            MEMBER.key(ROBOT.public_key): to_value(robot),
            REGISTRAR.key(SIGNER): "ward",
        }
        for number, row in enumerate(roster.rows):
            member = b"M%32d" % number
            self.state[HANDLE.key(row.handle)] = member
            known = MemberRow(row.handle, "subject", "ward", row.spend, row.view, row.sealing, "active", 0)
            self.state[MEMBER.key(member)] = to_value(known)

    async def state_values(self, keys: Sequence[bytes], key: PrivateKey) -> ProvedState:
        await asyncio.sleep(0.002)
        if self.failure:
            raise BlockRobotError(self.failure)
        assert key is ROBOT
        assert 1 <= len(keys) <= 128
        self.asked.extend(keys)
        if not self.idle:
            self.block()
        return ProvedState(self.height, self.time_ms, {flat: self.state.get(flat) for flat in keys})

    async def catch_up(self, key: PrivateKey) -> None:
        self.caught_up += 1

    async def confirm_with_quorum(self) -> bool:
        """Whether a quorum answers. When the robot's own node is cut off, what the others have is seen by it."""
        self.quorums_asked += 1
        await asyncio.sleep(0.002)
        if self.cut_off:
            return False
        return not self.failure

    async def is_rejected_by_network(self) -> bool:
        return not self.others_serve

    def block(self) -> None:
        self.height += 1
        self.time_ms = self.now_ms()

    def say(
        self,
        handle: bytes,
        status: str = "given",
        *,
        purpose: str = "demo",
        sensor: str = "depth",
        since_ms: int | None = None,
        from_ms: int = 0,
        until_ms: int = 0,
        height: int | None = None,
    ) -> None:
        """Write what holds from the next block on, or from `height`."""
        self.block()
        row = self.state.setdefault(CHOICES.key(handle), {})
        since = self.time_ms if since_ms is None else since_ms
        step = [self.height + 1 if height is None else height, status, since, from_ms, until_ms, b""]
        steps = row.setdefault(purpose, {}).get(sensor, [])
        row[purpose][sensor] = [*[one for one in steps if one[0] <= self.height][-1:], step]
        self.state[consent.CHANGES.flat] += 1

    def leave(self, handle: bytes) -> None:
        gone = MemberRow(handle, "subject", "ward", b"", b"", b"", "left", 0)
        self.state[MEMBER.key(self.state[HANDLE.key(handle)])] = to_value(gone)
        self.state[identity.CHANGES.flat] += 1


def consents_on(
    registry: RegistryStandIn,
    roster: Roster,
    stale_after_ms: int = STALE_AFTER_MS,
    tell: Callable[[str], None] = lambda _sentence: None,
) -> Consents:
    """The robot's view of that registry; nothing is read yet."""
    book = RosterBook(roster, SIGNER)
    reader = RegistryReader(registry, ROBOT, book)
    return Consents(
        reader,
        book,
        majority=registry,
        person_key=PERSON_KEY,
        stale_after_ms=lambda: stale_after_ms,
        now_ms=registry.now_ms,
        tell=tell,
    )

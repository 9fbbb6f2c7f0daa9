"""The visits that a robot has open: one owner key for each person, for at most ten minutes.

The secret r of a visit is used once and forgotten; the robot can then record for the owner but not find her again. When
a visit is to be closed on the chain is drawn as it is opened, and nothing that happens in it changes that. Must never
write r, s, or which handle a visit belongs to.
"""

from __future__ import annotations

import random
import secrets
from dataclasses import dataclass

from clients.robot.recording.sealing import VisitChain, compute_time_bucket
from consensus.limits import VISIT_MAX_MS
from consensus.members.roster import RosterRow
from consensus.records.owner_keys import open_visit_keys

# A visit is closed a minute early, so that its last records are on the chain before it ends.
_VISIT_ROLL_MS = VISIT_MAX_MS - 60_000

CLOSE_DELAY_MAX_MS = 60_000
"""How long after the nine minutes of a visit it is closed at most, if its records are final."""


@dataclass(slots=True)
class _Open:
    chain: VisitChain
    opened_at_ms: int


class VisitBook:
    """Opens a visit when a person is first recorded, and a new one before ten minutes are over."""

    def __init__(self, chain_id: bytes, robot: bytes, purpose: str) -> None:
        self._chain_id = chain_id
        self._robot = robot
        self._purpose = purpose
        self._open: dict[str, _Open] = {}
        self._closes_at_ms: dict[bytes, int] = {}  # by owner key, also of visits that are forgotten

    def chain_for(self, alias: str, row: RosterRow, now_ms: int) -> VisitChain:
        """Return the chain of the person's open visit, opening one if there is none."""
        self._forget_ended(now_ms)
        known = self._open.get(alias)
        if known is not None:
            return known.chain
        keys = open_visit_keys(secrets.token_bytes(32), row.view, row.spend, chain_id=self._chain_id, robot=self._robot)
        chain = VisitChain(
            owner=keys.owner,
            ephemeral=keys.ephemeral,
            view_tag=keys.view_tag,
            purpose=self._purpose,
            bucket_ms=compute_time_bucket(now_ms),
            sealing=row.sealing,
        )
        self._open[alias] = _Open(chain=chain, opened_at_ms=now_ms)
        self._closes_at_ms[chain.owner] = now_ms + _VISIT_ROLL_MS + random.SystemRandom().randrange(CLOSE_DELAY_MAX_MS)
        return chain

    def _forget_ended(self, now_ms: int) -> None:
        """Forget whose the visits were that are over: who steals a running robot must not find them in its memory."""
        self._open = {
            alias: visit for alias, visit in self._open.items() if now_ms - visit.opened_at_ms < _VISIT_ROLL_MS
        }

    def goes_on(self, owner: bytes, now_ms: int) -> bool:
        """Tell whether the chain is to see the visit of an owner key open still. Once it is not, nothing is recorded in it.

        It is until nine minutes and a random delay are over, whatever ended it here: closed when its person takes her
        consent back, which the chain shows under her handle, it would tell whose it was.
        """
        self._forget_ended(now_ms)
        if now_ms >= self._closes_at_ms.get(owner, now_ms):
            self._closes_at_ms.pop(owner, None)
        return owner in self._closes_at_ms

    def forget(self, alias: str) -> None:
        """Record no more in a person's visit: should she be recorded again, it is in a new one."""
        self._open.pop(alias, None)

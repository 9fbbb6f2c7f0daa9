"""Open visits: one owner key per person, for at most ten minutes.

The secret r is used once; closing time is drawn at opening. r, s and the visit's handle are never written.
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


class VisitKeyring:
    """Opens visits, replaced before ten minutes are over."""

    def __init__(self, chain_id: bytes, robot: bytes, purpose: str) -> None:
        self._chain_id = chain_id
        self._robot = robot
        self.purpose = purpose
        self._open: dict[str, _Open] = {}
        self._closes_at_ms: dict[bytes, int] = {}  # by owner key, also of visits that are forgotten

    def chain_for(self, alias: str, row: RosterRow, now_ms: int) -> VisitChain:
        self._forget_ended(now_ms)
        known = self._open.get(alias)
        if known is not None:
            return known.chain
        keys = open_visit_keys(secrets.token_bytes(32), row.view, row.spend, chain_id=self._chain_id, robot=self._robot)
        chain = VisitChain(
            owner=keys.owner,
            ephemeral=keys.ephemeral,
            view_tag=keys.view_tag,
            purpose=self.purpose,
            bucket_ms=compute_time_bucket(now_ms),
            sealing=row.sealing,
        )
        self._open[alias] = _Open(chain=chain, opened_at_ms=now_ms)
        self._closes_at_ms[chain.owner] = now_ms + _VISIT_ROLL_MS + random.SystemRandom().randrange(CLOSE_DELAY_MAX_MS)
        return chain

    def _forget_ended(self, now_ms: int) -> None:
        """A stolen robot does not give them away."""
        self._open = {
            alias: visit for alias, visit in self._open.items() if now_ms - visit.opened_at_ms < _VISIT_ROLL_MS
        }

    def goes_on(self, owner: bytes, now_ms: int) -> bool:
        """Return whether a visit stays open on chain: nine minutes plus random delay, independent of consent, hiding its
        owner.
        """
        self._forget_ended(now_ms)
        if now_ms >= self._closes_at_ms.get(owner, now_ms):
            self._closes_at_ms.pop(owner, None)
        return owner in self._closes_at_ms

    def forget(self, alias: str) -> None:
        """Drop a person's keys: their next visit gets new ones."""
        self._open.pop(alias, None)

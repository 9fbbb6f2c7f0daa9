"""Adds a node to a local network, approved by locally held organisation keys.

Without a local majority, it reports what the others have to do and stops.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from clients.sdk.chain.governance import (
    Decision,
    Governor,
    MembershipView,
    ProvedProposal,
    read_membership,
    read_producers,
)
from clients.sdk.network_client import NetworkClient
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from node.config import LOOPBACK
from pages.listening import is_loopback

SEAT_TIMEOUT_S = 60.0
FAR_SHOWN_COUNT = 3
_POLL_S = 0.2


@dataclass(frozen=True, slots=True)
class Step:
    """One completed step: actor (empty: this machine), action, final height if any."""

    who: str
    what: str
    height: int | None = None

    def sentence(self) -> str:
        speaker = f"{self.who}: " if self.who else ""
        return f"{speaker}{self.what}" + ("" if self.height is None else f" (final at height {self.height})")


@dataclass
class NodeAddition:
    """Local organisations by name with admin keys, and the receiver of steps."""

    client: NetworkClient
    voices: Mapping[str, PrivateKey]
    on_progress: Callable[[Step], None]
    waiting_for: list[str] = field(default_factory=list)

    async def begin(self) -> MembershipView:
        """Read the membership. Raises GOVERNANCE_NOT_ADMIN if no local key may ask, CONFIGURATION_INVALID if some of its
        nodes are on other machines, where nobody would find one at this machine's own address.
        """
        membership: MembershipView | None = None
        known = {}
        for name, key in self.voices.items():
            try:
                membership = await read_membership(self.client, key)
            except BlockRobotError as error:
                if error.code != "SESSION_REFUSED":
                    raise
                continue
            if any(row.name == name for row in membership.organisations):
                known[name] = key
        if membership is None or not known:
            raise BlockRobotError("GOVERNANCE_NOT_ADMIN")
        self.voices = known
        far = [node.name for node in membership.nodes if node.status == "active" and not is_loopback(node.host)]
        if far:
            detail = (
                f"{', '.join(far[:FAR_SHOWN_COUNT])} of this network would not reach a node at {LOOPBACK}: make it with"
            )
            raise BlockRobotError("CONFIGURATION_INVALID", f"{detail} `blockrobot node init --bind ADDRESS`.")
        return membership

    def _order(self, first: str) -> list[str]:
        return [name for name in self.voices if name == first] + [name for name in self.voices if name != first]

    async def agree(self, kind: str, arguments: dict[str, Any], first: str) -> bool:
        what = f"{kind.replace('_', '-')} {arguments.get('name') or arguments.get('node')}"
        proposal: ProvedProposal | None = None
        for name in self._order(first):
            governor = Governor(self.client, self.voices[name])
            if proposal is None:
                decision = await governor.propose("membership", kind, arguments)
                self.on_progress(Step(name, f"org propose {what}", decision.height))
            else:
                decision = await governor.approve(proposal)
                self.on_progress(Step(name, f"org approve {proposal.id.hex()[:12]} ({what})", decision.height))
            if decision.executed:
                return True
            proposal = proposal or await self._opened(decision, self.voices[name])
        shown = "PROPOSAL" if proposal is None else proposal.id.hex()[:12]
        self.waiting_for.append(f"blockrobot org approve {shown} --as ORG   (an organisation whose key is not here)")
        return False

    async def _opened(self, decision: Decision, reader: PrivateKey) -> ProvedProposal | None:
        rows = (await read_membership(self.client, reader)).proposals
        return next((row for row in rows if row.id == decision.proposal_id), None)

    async def vote_in(self, node: str, key: bytes, first: str) -> bool:
        needed = 0
        for count, name in enumerate(self._order(first)):
            governor = Governor(self.client, self.voices[name])
            if count == 0:
                needed = (await read_membership(self.client, self.voices[name])).majority
                decision = await governor.vote("propose", key)
                self.on_progress(Step(name, f"producer propose {node}", decision.height))
            else:
                decision = await governor.vote("approve", key)
                self.on_progress(Step(name, f"producer approve {node}", decision.height))
            if count + 1 >= needed:
                return True
        self.waiting_for.append(
            f"blockrobot producer approve {node} --as ORG   (an organisation whose key is not here)"
        )
        return False

    async def wait_seated(self, node: str, key: bytes, timeout_s: float = SEAT_TIMEOUT_S) -> None:
        """Wait until the node is ready and seated. Raises CLUSTER_START_FAILED on timeout."""
        reader = next(iter(self.voices.values()))
        deadline = time.monotonic() + timeout_s
        while True:
            view = await read_producers(self.client, reader)
            row = next((row for row in view.candidates if row.key == key), None)
            if row is not None and row.turn is not None:
                self.on_progress(
                    Step("", f"{node} was ready at height {row.ready_height}: it has a seat", view.since_height)
                )
                count = len(view.epoch.producers)
                self.on_progress(Step("", f"{count} producers; they bear {(count - 1) // 3} that fail"))
                return
            if len(view.epoch.producers) >= view.max_producers:
                self.on_progress(
                    Step("", f"{node} is a candidate; all {view.max_producers} seats are taken (max_producers)")
                )
                return
            if time.monotonic() > deadline:
                raise BlockRobotError(
                    "CLUSTER_START_FAILED", f"{node} got no seat in {timeout_s:.0f} s; see blockrobot producer list."
                )
            await asyncio.sleep(_POLL_S)

"""State of the contract `officers`: two-officer erasure proposals for lost keys."""

from __future__ import annotations

from typing import Literal

from consensus.state.audit import DayRow
from consensus.state.keys import HASH_BYTES, KEY_BYTES, U64_BYTES, Prefix, Row, StateKey

OFFICERS = "officers"


class ProposalRow(Row, frozen=True):
    """A proposal to erase a robot's recordings of a span; `approver` is empty until approval."""

    number: int
    robot: bytes
    org: str
    from_ms: int
    until_ms: int
    reason: str
    visits_max: int
    visits: int
    records: int
    status: Literal["proposed", "approved", "stopped"]
    proposer: bytes
    approver: bytes
    proposed_ms: int
    approved_ms: int
    ends_ms: int


PROPOSAL: Prefix[ProposalRow] = Prefix(OFFICERS, "proposal/", (HASH_BYTES,), ProposalRow)
PROPOSAL_NUMBER: Prefix[bytes] = Prefix(OFFICERS, "proposal-number/", (U64_BYTES,), bytes)
"""The id of a proposal by its number, from 0."""
PROPOSAL_COUNT: StateKey[int] = StateKey(OFFICERS, "proposal-count", int)
"""How many there ever were."""
TOUCHED: Prefix[bool] = Prefix(OFFICERS, "touched/", (HASH_BYTES, KEY_BYTES), bool)
"""There for each visit of which something was erased under a proposal."""
DAY: Prefix[DayRow] = Prefix(OFFICERS, "day/", (HASH_BYTES,), DayRow)
"""By the handle of the officer who proposed."""
LAYOUT = (PROPOSAL, PROPOSAL_NUMBER, PROPOSAL_COUNT, TOUCHED, DAY)

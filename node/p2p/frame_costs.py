"""Costs of frames and of requests between nodes, in estimated microseconds of CPU."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from node.limits.work_costs import EC_OPERATION_US, REFUSAL_US
from node.p2p.wire import FrameKind, RequestKind


class Lane(Enum):
    """The budget a frame is paid from, most urgent first."""

    CONSENSUS = "consensus"
    GOSSIP = "gossip"
    CONTROL = "control"
    REQUEST = "request"
    LINK = "link"


@dataclass(frozen=True, slots=True)
class FrameCost:
    """A frame's handling cost, besides `FRAME_US` and its bytes."""

    lane: Lane
    us: int


FRAME_COSTS: Mapping[FrameKind, FrameCost] = {
    FrameKind.HELLO: FrameCost(Lane.LINK, 100),
    FrameKind.REFUSAL: FrameCost(Lane.LINK, 50),
    FrameKind.PROPOSAL: FrameCost(Lane.CONSENSUS, 4 * EC_OPERATION_US),
    FrameKind.VOTE: FrameCost(Lane.CONSENSUS, EC_OPERATION_US + 50),
    FrameKind.TIMEOUT: FrameCost(Lane.CONSENSUS, 4 * EC_OPERATION_US),
    FrameKind.NOTICE: FrameCost(Lane.CONSENSUS, 4 * EC_OPERATION_US),
    FrameKind.LAST_SIGNED_RESPONSE: FrameCost(Lane.CONSENSUS, 4 * EC_OPERATION_US),
    FrameKind.EPOCH: FrameCost(Lane.CONTROL, 4 * EC_OPERATION_US),
    FrameKind.LAST_SIGNED_REQUEST: FrameCost(Lane.CONTROL, 200),
    FrameKind.HEIGHT: FrameCost(Lane.CONTROL, 50),
    FrameKind.TRANSACTIONS: FrameCost(Lane.GOSSIP, 50),
    FrameKind.REQUEST: FrameCost(Lane.REQUEST, REFUSAL_US),
    FrameKind.RESPONSE: FrameCost(Lane.LINK, 20),
}

REQUEST_COSTS: Mapping[RequestKind, int] = {
    RequestKind.BRANCH: 2_000,
    RequestKind.FINALIZED: 2_000,
    RequestKind.CLIP: 300,
    RequestKind.BACKGROUND: 300,
    RequestKind.SNAPSHOT: 1_000,
}
"""Answering a peer's request, besides the bytes of the answer."""

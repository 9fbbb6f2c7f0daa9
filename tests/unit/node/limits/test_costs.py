"""Everything that somebody can ask of a node has a price, and the flood bench sends all of it."""

from __future__ import annotations

from network.bench.flood.flood_kinds import FRAMES
from network.bench.flood.flood_routes import kinds_of
from node.api.routes import ROUTES
from node.limits.work_costs import ROUTE_COSTS
from node.p2p.frame_costs import FRAME_COSTS, REQUEST_COSTS, Lane
from node.p2p.wire import FrameKind, RequestKind

OPERATIONS = {route.operation for route in ROUTES}


def test_every_kind_of_frame_and_request_and_every_route_has_a_price() -> None:
    assert set(FRAME_COSTS) == set(FrameKind)
    assert all(cost.us > 0 for cost in FRAME_COSTS.values())
    assert set(REQUEST_COSTS) == set(RequestKind)
    assert set(ROUTE_COSTS) == OPERATIONS
    assert min(ROUTE_COSTS.values()) > 0
    heard = {FrameKind.PROPOSAL, FrameKind.VOTE, FrameKind.TIMEOUT, FrameKind.NOTICE, FrameKind.LAST_SIGNED_RESPONSE}
    assert {kind for kind, cost in FRAME_COSTS.items() if cost.lane is Lane.CONSENSUS} == heard


def test_the_flood_bench_sends_every_kind_of_frame_and_request_and_asks_every_route() -> None:
    frames = {name.partition(":")[0] for name in FRAMES}
    assert frames >= {kind.name for kind in FrameKind}
    assert {name for name in FRAMES if name.startswith("REQUEST:")} == {f"REQUEST:{kind.name}" for kind in RequestKind}
    assert {name.partition(":")[0] for name in kinds_of("member")} == OPERATIONS | {"stray"}
    assert set(kinds_of("stranger")) >= set(kinds_of("member"))

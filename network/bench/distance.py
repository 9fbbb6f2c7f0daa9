"""What distance between hosts costs: every link of a local network is slowed down and made lossy.

The client sits beside one of the nodes, as a ward's robot does.
"""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable, Mapping, Sequence

from msgspec import Struct

from consensus.errors import BlockRobotError
from network.bench.conditions import Result, latency_figures, measure_conditions
from network.bench.fault_recovery import watch_kill
from network.bench.finality_probe import FinalityProbe
from network.bench.fresh_network import FreshNetwork, LoadRobot
from network.bench.latency import time_calls
from network.cluster import read_metric
from network.demo.leader_kill import find_leader
from network.faults.actions import SetLink
from network.faults.control import FaultControl
from node.p2p.link_faults import LinkFault

GOAL_DELAYS, GOAL_EXTRA_MS = 4.5, 15.0
"""A call is to be final (p50) within so many one-way delays, and so much that machines take."""
WARM_UP_S, WATCH_S = 3.0, 8.0
SENT_BYTES = "blockrobot_peer_bytes_total"


class Distance(Struct, frozen=True, kw_only=True):
    """What was measured at one delay and loss.

    `leader_gap_s`: the longest time without finality after the leader's host is lost; `bytes_per_call`: what all nodes
    sent each other for a call on an idle network.
    """

    delay_ms: float
    loss_percent: float
    p50_ms: float
    p95_ms: float
    goal_ms: float
    is_within_goal: bool
    delays: float
    leader_gap_s: float
    bytes_per_call: int
    calls: int
    errors: int
    error_codes: dict[str, int]


class DistanceFigures(Struct, frozen=True, kw_only=True):
    """One line for each delay and loss."""

    distances: list[Distance]


async def run_wan_benchmark(
    *,
    delays_ms: Sequence[float],
    losses_percent: Sequence[float],
    nodes: int,
    count: int,
    tell: Callable[[str], None],
) -> Result[DistanceFigures]:
    """`ok` is False after any error, or where a loss-free median misses its goal."""
    conditions = measure_conditions(nodes=nodes, clients=1, calls=count, call="records.record")
    measured = []
    for delay_ms, loss in itertools.product(delays_ms, losses_percent):
        found = await _measure(delay_ms, loss, nodes, count)
        measured.append(found)
        tell(
            f"{delay_ms:g} ms one way, {loss:g} % lost: p50 {found.p50_ms:.0f} ms ({found.delays:.1f} delays), "
            f"p95 {found.p95_ms:.0f} ms, without the leader's host {found.leader_gap_s:.2f} s"
        )
    is_ok = all(not each.errors and (each.loss_percent > 0 or each.is_within_goal) for each in measured)
    return Result(name="wan", ok=is_ok, figures=DistanceFigures(distances=measured), conditions=conditions)


async def _measure(delay_ms: float, loss_percent: float, nodes: int, count: int) -> Distance:
    async with FreshNetwork(nodes, faults=True) as network:
        robots = await network.enrol_robots(nodes)
        control = FaultControl(network.cluster)
        fault = LinkFault(delay_ms=delay_ms, loss=loss_percent / 100)
        for one, other in itertools.combinations(network.cluster.names, 2):
            await control.carry_out(SetLink(one, other, fault, is_both=True))
        before = await _sent_bytes(network)
        values_ms, errors = await time_calls(robots[0], count)
        sent = await _sent_bytes(network) - before
        by_node = {node.name: robot for node, robot in zip(network.genesis.nodes, robots, strict=True)}
        gap_s = await _lose_leader(network, by_node)
    figures, goal_ms = latency_figures(values_ms, (50, 95)), GOAL_DELAYS * delay_ms + GOAL_EXTRA_MS
    return Distance(
        delay_ms=delay_ms,
        loss_percent=loss_percent,
        p50_ms=figures["p50_ms"],
        p95_ms=figures["p95_ms"],
        goal_ms=goal_ms,
        is_within_goal=bool(values_ms) and figures["p50_ms"] <= goal_ms,
        delays=round(figures["p50_ms"] / delay_ms, 2) if delay_ms else 0.0,
        leader_gap_s=round(gap_s, 3),
        bytes_per_call=round(sent / max(1, len(values_ms))),
        calls=len(values_ms),
        errors=sum(errors.values()),
        error_codes=errors,
    )


async def _sent_bytes(network: FreshNetwork) -> float:
    configs = network.cluster.configs.values()
    sent = await asyncio.gather(*(read_metric(config, SENT_BYTES, 'direction="sent"') for config in configs))
    return sum(each or 0.0 for each in sent)


async def _lose_leader(network: FreshNetwork, robots: Mapping[str, LoadRobot]) -> float:
    victim = await find_leader(network.cluster)
    witness = next(node for node in network.genesis.nodes if node.name != victim)
    async with FinalityProbe(network.genesis, witness, robots[witness.name]) as probe:
        gap_s = await watch_kill(network, victim, probe, WARM_UP_S, WATCH_S)
        if gap_s >= WATCH_S or await probe.settle():
            raise BlockRobotError("INTERNAL", f"Without {victim} nothing was final any more, or calls were lost.")
    return gap_s

"""Faults requested by command or button, one or a plan of them: parsing, checks and application."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from consensus.errors import BlockRobotError
from network.cluster import Cluster
from network.faults.actions import Action, ActionReader, FillDisk, GoByzantine, Heal, Restart, Skew, check_seed
from network.faults.control import FaultControl
from network.faults.plan import STEP_FIELDS, FaultPlan, Step, action_of

LINK_SEED = "seed"


def open_control(cluster: Cluster, seed: int = 0) -> FaultControl:
    """Raises CLUSTER_NOT_RUNNING."""
    if not any(cluster.is_running(name) for name in cluster.names):
        raise BlockRobotError("CLUSTER_NOT_RUNNING", f"No node of the network in {cluster.folder} is running.")
    return FaultControl(cluster, seed)


def read_action(fields: Mapping[str, Any], names: tuple[str, ...]) -> tuple[Action, int]:
    """The action of `do`, and the link's seed. Raises FAULT_UNKNOWN, FAULT_INVALID."""
    table = dict(fields)
    kind = table.pop("do", None)
    if not isinstance(kind, str) or kind not in STEP_FIELDS:
        raise BlockRobotError("FAULT_UNKNOWN", f"There is no fault {kind!r}; there are {', '.join(STEP_FIELDS)}.")
    seed = 0
    if kind == "link" and LINK_SEED in table:
        seed = table.pop(LINK_SEED)
        if not isinstance(seed, int) or isinstance(seed, bool):
            raise BlockRobotError("FAULT_INVALID", "seed is missing or not a whole number.")
        check_seed(seed)
    for key in table:
        if key not in STEP_FIELDS[kind]:
            has = ", ".join(sorted(STEP_FIELDS[kind]))
            raise BlockRobotError("FAULT_INVALID", f"{kind} has no {key!r}; it has {has}.")
    return action_of(ActionReader(names), kind, table), seed


async def carry_out_requested(control: FaultControl, action: Action) -> tuple[str, ...]:
    """Wait for started nodes and return them. Raises as `FaultControl.carry_out` and `wait_answering`."""
    started: tuple[str, ...] = ()
    match action:
        case Skew(node=node, offset_ms=offset_ms) if offset_ms:
            control.require_running(node)
        case FillDisk(node=node, is_full=True):
            control.require_running(node)
        case Restart(node=node) | GoByzantine(node=node):
            started = (node,)
        case Heal(nodes=nodes):
            started = tuple(name for name in nodes or control.cluster.names if control.cluster.behaviour(name))
    await control.carry_out(action)
    for name in started:
        await control.cluster.wait_answering(name)
    return started


@dataclass(frozen=True, slots=True)
class StepDone:
    """Result of a step: time after the plan's start, and error if any."""

    step: Step
    at_ms: int
    error: BlockRobotError | None


async def run_plan(plan: FaultPlan, control: FaultControl, on_progress: Callable[[StepDone], None]) -> list[StepDone]:
    """Report each step to `on_progress`. A failed step does not end the plan; its error is reported."""
    loop = asyncio.get_running_loop()
    started_s = loop.time()
    done: list[StepDone] = []
    for step in plan.steps:
        await asyncio.sleep(max(0.0, started_s + step.at_ms / 1000 - loop.time()))
        error = None
        try:
            await control.carry_out(step.action)
        except BlockRobotError as problem:
            error = problem
        done.append(StepDone(step, round((loop.time() - started_s) * 1000), error))
        on_progress(done[-1])
    return done

"""Runs a fault plan, step by step, on time."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass

from consensus.errors import BlockRobotError
from network.faults.control import FaultControl
from network.faults.plan import FaultPlan, Step


@dataclass(frozen=True, slots=True)
class StepDone:
    """Result of a step: time after the plan's start, and error if any."""

    step: Step
    at_ms: int
    error: BlockRobotError | None


async def run_plan(plan: FaultPlan, control: FaultControl, tell: Callable[[StepDone], None]) -> list[StepDone]:
    """Run a plan, report each step to `tell` and return all.

    A failed step does not end the plan; its error is reported.
    """
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
        tell(done[-1])
    return done

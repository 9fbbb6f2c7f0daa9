"""The second experiment on the first seconds of its scenario: in a test's own process, or as a program to be killed."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec

from clients.robot.synthetic.scenario import Scenario
from clients.robot.synthetic.scenario_bag import scenario_of
from network.bench.fresh_network import find_base_port
from network.demo.checks import Check
from network.experiments.definitions import EXPERIMENTS, Experiment
from network.experiments.run_all import RunOptions, run_experiments

EXPERIMENT = EXPERIMENTS[1]


def shortened(seconds: float) -> Scenario:
    """The scenario's first seconds, with the readings that fall into them."""
    whole = scenario_of(EXPERIMENT.load_scene())
    people = tuple(
        replace(person, readings_s=tuple(at for at in person.readings_s if at < seconds)) for person in whole.people
    )
    return replace(whole, name="short", duration_s=seconds, people=people, digest=f"{round(seconds * 1000):064d}")


async def run_short(
    folder: Path, seconds: float, show: Callable[[Experiment, Check], None], on: str = ""
) -> dict[str, Any]:
    """Run it in `folder/out`, with recordings in `folder/cache` (at home); return the result."""
    options = RunOptions(
        out=folder / "out",
        cache=folder / "cache",
        base_port=find_base_port(4),
        on_progress=lambda _: None,
        show=show,
        on=on,
    )
    result, _ = await run_experiments([(EXPERIMENT, shortened(seconds))], options)
    return dict(msgspec.to_builtins(result))


if __name__ == "__main__":
    sys.exit(not asyncio.run(run_short(Path(sys.argv[1]), float(sys.argv[2]), lambda *_: None))["ok"])

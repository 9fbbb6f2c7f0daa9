"""Runs experiments, each on its own network, and writes the results."""

from __future__ import annotations

import asyncio
import json
import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import msgspec

from clients.robot.synthetic.scenario_bag import Scene, scenario_of
from consensus.errors import BlockRobotError
from network.bench.conditions import Result, measure_conditions
from network.demo.checks import Check, CheckList
from network.experiments.comparison import MAP_FILE, write_reading
from network.experiments.definitions import Experiment
from network.experiments.guard import Guard
from network.experiments.out_folder import REPORT_FILE, SUMMARY_FILE, make_experiment_folder, reserved_out
from network.experiments.pages.experiment_page import build_index, build_page
from network.experiments.run_one import ExperimentRun, Outcome, OutcomeFigures
from network.testbed import NODES_COUNT


@dataclass(frozen=True, slots=True)
class RunOptions:
    """Output and cache folders, first port, and receivers of progress and checks."""

    out: Path
    cache: Path
    base_port: int
    on_progress: Callable[[str], None]
    show: Callable[[Experiment, Check], None]


async def run_experiments(
    chosen: Sequence[tuple[Experiment, Scene]], options: RunOptions
) -> tuple[Result[dict[str, OutcomeFigures | float]], list[Outcome]]:
    """Run experiments; return the result, which has figures of each and the `seconds` of all, and outcomes.

    Raises FOLDER_NOT_EMPTY. Stops everything it started, also on Ctrl-C, SIGTERM, SIGHUP, or by the guard if killed.
    """
    _cancel_on_signals()
    conditions = measure_conditions(
        nodes=NODES_COUNT, scenarios={item.name: scenario_of(scene).digest[:16] for item, scene in chosen}
    )
    outcomes = []
    with reserved_out(options.out), Guard() as guard:
        started = time.monotonic()
        for experiment, scene in chosen:
            outcomes.append(await _run_one(experiment, scene, options, guard))
        seconds = round(time.monotonic() - started, 1)
        figures = {outcome.experiment.name: outcome.figures() for outcome in outcomes}
        conditions["drawn_by"] = _drawn_by(outcomes, options.out)
        ok = bool(outcomes) and all(outcome.ok for outcome in outcomes)
        result = Result[dict[str, OutcomeFigures | float]](
            name="experiments", ok=ok, figures={**figures, "seconds": seconds}, conditions=conditions
        )
        _write(options.out / SUMMARY_FILE, json.dumps(msgspec.to_builtins(result), indent=2) + "\n")
        _write(options.out / REPORT_FILE, build_index(outcomes, seconds, conditions))
    return result, outcomes


def _cancel_on_signals() -> None:
    task, loop = asyncio.current_task(), asyncio.get_running_loop()
    assert task is not None
    for number in (signal.SIGTERM, signal.SIGHUP):
        loop.add_signal_handler(number, task.cancel)


async def _run_one(experiment: Experiment, scene: Scene, options: RunOptions, guard: Guard) -> Outcome:
    folder = await asyncio.to_thread(make_experiment_folder, options.out, experiment.name)

    def listen(check: Check) -> None:
        options.show(experiment, check)

    run = ExperimentRun(
        experiment,
        scene,
        folder,
        cache=options.cache,
        base_port=options.base_port,
        checks=CheckList(listener=listen),
        on_progress=lambda line: options.on_progress(f"{experiment.name}: {line}"),
        guard=guard,
    )
    try:
        outcome = await run.run()
    finally:
        await run.stop()
    await asyncio.to_thread(_leave, outcome, folder)
    return outcome


def _leave(outcome: Outcome, folder: Path) -> None:
    refusal: BlockRobotError | None = None
    drawn: str | None = None
    if outcome.reading is not None:
        refusal = write_reading(outcome.reading, folder)
        if refusal is None:
            drawn = (folder / f"{MAP_FILE}.svg").read_text(encoding="utf-8")
    _write(folder / SUMMARY_FILE, json.dumps(msgspec.to_builtins(outcome.figures()), indent=2) + "\n")
    _write(folder / REPORT_FILE, build_page(outcome, refusal, drawn))


def _drawn_by(outcomes: Sequence[Outcome], out: Path) -> str:
    drawn = [(out / outcome.experiment.name / "process-map.png").is_file() for outcome in outcomes]
    return "graphviz" if drawn and all(drawn) else "blockrobot"


def _write(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8")

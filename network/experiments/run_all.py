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
from clients.sdk.new_files import replace_file
from clients.sdk.terminal.terminal import home_folder
from consensus.errors import BlockRobotError
from network.bench.cluster import cluster_pool
from network.bench.conditions import Result, measure_conditions
from network.demo.checks import Check, CheckList
from network.experiments.comparison import MAP_FILE, write_reading
from network.experiments.definitions import EXPERIMENTS, Experiment
from network.experiments.guard import Guard
from network.experiments.on_workers import only_one_on_this_machine, pack_results, unpack_results
from network.experiments.out_folder import REPORT_FILE, SUMMARY_FILE, make_experiment_folder, reserved_out
from network.experiments.pages.experiment_page import build_index, build_page
from network.experiments.run_one import ExperimentRun, Outcome, OutcomeFigures
from network.testbed import NODES_COUNT


@dataclass(frozen=True, slots=True)
class RunOptions:
    """Output and cache folders, first port, receivers of progress and checks, and a cluster's scheduler, if any."""

    out: Path
    cache: Path
    base_port: int
    on_progress: Callable[[str], None]
    show: Callable[[Experiment, Check], None]
    on: str = ""


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
    conditions["work_on"] = options.on or "this machine"
    with reserved_out(options.out):
        started = time.monotonic()
        outcomes = await (_run_on_workers(chosen, options) if options.on else _run_here(chosen, options))
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


async def _run_here(chosen: Sequence[tuple[Experiment, Scene]], options: RunOptions) -> list[Outcome]:
    with Guard() as guard:
        return [await _run_one(experiment, scene, options, guard) for experiment, scene in chosen]


async def _run_on_workers(chosen: Sequence[tuple[Experiment, Scene]], options: RunOptions) -> list[Outcome]:
    outcomes = []
    with cluster_pool(options.on) as pool:
        jobs = [pool.submit(run_as_worker, experiment, scene, options.base_port) for experiment, scene in chosen]
        options.on_progress(f"{len(jobs)} experiments are handed to the cluster")
        for (experiment, _), job in zip(chosen, jobs, strict=True):
            outcome, packed = await asyncio.wrap_future(job)
            folder = await asyncio.to_thread(make_experiment_folder, options.out, experiment.name)
            await asyncio.to_thread(unpack_results, packed, folder)
            for check in outcome.checks.checks:
                options.show(experiment, check)
            outcomes.append(outcome)
    return outcomes


def run_as_worker(experiment: Experiment, scene: Scene, base_port: int) -> tuple[Outcome, bytes]:
    """The outcome, and its folder as a tar file. A worker that is killed leaves no process behind, as at home."""
    out, cache = home_folder() / "on-worker", home_folder() / "recordings"
    options = RunOptions(out, cache, base_port, on_progress=_say_nothing, show=_say_nothing)
    with only_one_on_this_machine(), reserved_out(out):
        for known in EXPERIMENTS:  # of a worker that was killed
            make_experiment_folder(out, known.name)
        try:
            (outcome,) = asyncio.run(_run_here([(experiment, scene)], options))
            outcome.checks.listener = _say_nothing
            return outcome, pack_results(out / experiment.name)
        finally:
            make_experiment_folder(out, experiment.name)


def _say_nothing(*_: object) -> None:
    """A worker tells nobody how far it is."""


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
    replace_file(path, text.encode(), 0o644)

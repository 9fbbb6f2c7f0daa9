"""`blockrobot sim`: simulates networks in one process under seeded faults."""

from __future__ import annotations

import shlex
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from clients.sdk.new_files import write_new_file
from clients.sdk.terminal.terminal import EXIT_FAILED, FILE, command_output, console, print_json
from network.cli.measure.cluster_option import with_cluster

if TYPE_CHECKING:
    from network.bench.conditions import Condition
    from network.sim.history import Observation
    from network.sim.plan import Plan
    from network.sim.sweep import Failure, SweepResult

PROGRESS_INTERVAL_S = 5.0
NODES_MAX_COUNT = 10
NODES_DEFAULT_COUNT = 4
SEED_MAX = 1 << 32


@click.group()
def sim() -> None:
    """Play networks of production nodes on a virtual clock, network and disk.

    Example: blockrobot sim run --seeds 1..100
    """


def _parse_seeds(_context: click.Context, _parameter: click.Parameter, text: str) -> range:
    first, dots, last = text.partition("..")
    try:
        seeds = range(int(first), int(last if dots else first) + 1)
    except ValueError:
        raise click.BadParameter("seeds are one number, or a range as 1..100") from None
    if not seeds or seeds[0] < 0 or seeds[-1] >= SEED_MAX:
        raise click.BadParameter(f"seeds lie between 0 and {SEED_MAX - 1}, the smaller one first")
    return seeds


@sim.command("calibrate")
@command_output
def calibrate_command(as_json: bool) -> None:
    """Measure here what the cost model of `sim run --profile flood` charges, in microseconds of CPU.

    \b
    Example:
      blockrobot sim calibrate --json
    """
    from network.bench.conditions import measure_conditions  # noqa: PLC0415 - a node's code, only when it is needed
    from network.sim.calibration import measure_costs  # noqa: PLC0415
    from network.sim.world.cpu import CORE_SHARE, COSTS  # noqa: PLC0415

    conditions = measure_conditions(nodes=0, core_share=CORE_SHARE)
    charged = COSTS._asdict()
    figures = {
        name: {"measured_us": round(measured_us, 2), "charged_us": charged[name]}
        for name, measured_us in measure_costs()._asdict().items()
    }
    if as_json:
        print_json({"name": "sim-calibration", "ok": True, "figures": figures, "conditions": conditions})
        return
    for name, figure in figures.items():
        console.print(f"{name:12} {figure['measured_us']:8.2f} us here, {figure['charged_us']:8.2f} us in the model")


@sim.command("run")
@click.option("--seeds", default="1..20", show_default=True, callback=_parse_seeds, help="One seed, or A..B.")
@click.option(
    "--profile",
    default="faults",
    show_default=True,
    type=click.Choice(["faults", "grow", "custody", "flood"]),
    help="What the seeds play: see above.",
)
@click.option(
    "--nodes",
    default=NODES_DEFAULT_COUNT,
    show_default=True,
    type=click.IntRange(1, NODES_MAX_COUNT),
    help="Producers.",
)
@click.option(
    "--rounds", default=200, show_default=True, type=click.IntRange(10, 5_000), help="Rounds a seed, at least."
)
@click.option(
    "--byzantine", default=0, show_default=True, type=click.IntRange(0, 9), help="Dishonest nodes among them."
)
@click.option("--plan", "plan_file", type=FILE, help="Play this plan instead.")
@click.option("--workers", default=0, type=click.IntRange(0, 64), help="Processes (0: one a core).")
@with_cluster("workers")
@click.option("--trace", is_flag=True, help="Print every observation of a single seed or plan, on standard error.")
@command_output
def run_command(
    seeds: range,
    profile: str,
    nodes: int,
    rounds: int,
    byzantine: int,
    plan_file: Path | None,
    workers: int,
    on: str,
    trace: bool,
    as_json: bool,
) -> None:
    """Play seeds under faults and check what happened; exits 0 only if nothing that was promised was broken.

    Of what breaks, the command that replays it is printed, and a plan with no more faults than it takes. Progress goes
    to standard error: seeds played, rounds a second of real time, violations so far, and each seed that broke a promise.

    \b
    Profiles:
      faults  A fixed number of producers. Each seed draws up to a dozen crashes, power cuts, partitions, pauses, bad
              links, wrong clocks, slow, full and old disks; some seeds also change settings, or one producer's seat.
      grow    Four producers and six followers, which governance seats in two steps (7, then 10) and unseats again
              (4), over and over, under load and under the same faults but for old disks.
      custody Seven nodes, of which five, then six are custodians; two copies of each clip. One custodian joins, one
              leaves, one is lost with its disk, one more joins, in an order by the seed, under load with erasures in
              flight, under the same faults as grow: every clip has its copies again, what was erased is nowhere, and
              each custodian that had it has confirmed.
      flood   As many producers as the network bears send the others more than anybody should: transactions that are
              refused, requests, heights, questions. Work takes time of each node's core, by a table of measured costs
              (blockrobot sim calibrate); calls have to become final in 5x the time that they took before, at most.

    \b
    Links of a plan file (`profile` of the plan, or of a fault of kind `links`), delays in ms one way:
      lan 1-14   wifi 2-40, 1 % lost   wan 20-90   lossy 2-60, 15 % lost   storm 1-600, doubled and held back

    \b
    Examples:
      blockrobot sim run --seeds 1..100
      blockrobot sim run --seeds 1..1000 --byzantine 1 --json
      blockrobot sim run --profile grow --seeds 1..20
      blockrobot sim run --profile custody --rounds 60 --seeds 1..20
      blockrobot sim run --seeds 42 --trace
      blockrobot sim run --plan seed-42.toml --trace
      blockrobot sim run --seeds 1..100000 --on tls://scheduler.example:8786
    """
    from network.bench.conditions import measure_conditions  # noqa: PLC0415 - a node's code, only when it is needed
    from network.sim.plan import max_faulty  # noqa: PLC0415
    from network.sim.sweep import sweep  # noqa: PLC0415

    if plan_file is not None:
        _refuse_beside_a_plan()
        plans = [_read_plan(plan_file)]
    else:
        plans = _make_plans(seeds, profile, nodes, rounds, byzantine)
    if trace:
        if len(plans) != 1:
            raise click.UsageError("A trace is of one seed or one plan.")
        _print_trace(plans[0])
    first = plans[0]
    if len(first.byzantine) > max_faulty(first.size.producers):
        click.echo("More nodes lie than the network bears: what breaks now was never promised.", err=True)
    conditions = measure_conditions(
        nodes=first.nodes,
        seed=None if len(plans) > 1 else first.seed,
        seeds=f"{first.seed}..{plans[-1].seed}",
        rounds_a_seed=first.rounds,
        byzantine=len(first.byzantine),
        work_on=on or "processes",
    )
    total = sweep(plans, workers=workers or None, on=on, on_progress=_Progress(), on_shrink=_say_shrinking)
    _report(total, conditions, plan_file, as_json=as_json)
    if total.violations:
        sys.exit(EXIT_FAILED)


def _read_plan(path: Path) -> Plan:
    from network.sim.plan_file import load_plan  # noqa: PLC0415 - a node's code, only when it is needed

    return load_plan(path)


def _make_plans(seeds: range, profile: str, nodes: int, rounds: int, byzantine: int) -> list[Plan]:
    """Raises UsageError beyond the profile's capacity."""
    from network.sim.plan import make_custody_plan, make_flood_plan, make_growth_plan, max_faulty  # noqa: PLC0415 - a node's code, only when it is needed
    from network.sim.sweep import plan_of  # noqa: PLC0415

    if profile == "flood":
        if byzantine or max_faulty(nodes) == 0:
            raise click.UsageError("The profile flood has its own dishonest nodes, one or more of four or more.")
        return [make_flood_plan(seed, nodes=nodes, rounds=rounds) for seed in seeds]
    if profile in {"grow", "custody"}:
        if byzantine or nodes != NODES_DEFAULT_COUNT:
            raise click.UsageError(f"The profile {profile} has its own nodes, all of them honest.")
        make = make_growth_plan if profile == "grow" else make_custody_plan
        return [make(seed, rounds=rounds) for seed in seeds]
    if byzantine > max_faulty(nodes):
        text = f"Of {nodes} nodes at most {max_faulty(nodes)} may be dishonest: of more, nothing is promised."
        raise click.UsageError(text)
    return [plan_of(seed, nodes, rounds, byzantine) for seed in seeds]


def _refuse_beside_a_plan() -> None:
    """A plan overrides these options; refuse rather than ignore them."""
    context = click.get_current_context()
    for name in ("seeds", "profile", "nodes", "rounds", "byzantine"):
        if context.get_parameter_source(name) is not ParameterSource.DEFAULT:
            raise click.UsageError(f"The plan says what --{name} says: give one of the two.")


def _print_trace(plan: Plan) -> None:
    from network.sim.plan_file import plan_to_toml  # noqa: PLC0415 - a node's code, only when it is needed
    from network.sim.sweep import play  # noqa: PLC0415

    def show(observation: Observation) -> None:
        name = type(observation).__name__
        fields = [
            f"{field}={value.hex()[:12] if isinstance(value, bytes) else value}"
            for field, value in zip(observation.__struct_fields__[2:], _values(observation)[2:], strict=True)
            if not isinstance(value, tuple)
        ]
        who = "network" if observation.node < 0 else f"node-{observation.node + 1}"
        click.echo(f"{observation.at_ms:12.3f} {who:8} {name} {' '.join(fields)}", err=True)

    click.echo(plan_to_toml(plan), err=True)
    result = play(plan, show)
    click.echo(f"trace {result.trace}, {result.rounds} rounds, {result.frames} frames", err=True)


def _values(observation: Observation) -> list[Any]:
    return [getattr(observation, field) for field in observation.__struct_fields__]


class _Progress:
    def __init__(self) -> None:
        self._last_s = time.monotonic()
        self._failed_count = 0

    def __call__(self, total: SweepResult, count: int) -> None:
        now_s = time.monotonic()
        for result in total.failed[self._failed_count :]:
            click.echo(f"seed {result.seed} broke a promise: {result.violations[0]}", err=True)
        self._failed_count = len(total.failed)
        if now_s - self._last_s < PROGRESS_INTERVAL_S and total.seeds < count:
            return
        if total.seeds == count and total.elapsed_s < PROGRESS_INTERVAL_S:
            return
        self._last_s = now_s
        rate = total.rounds / total.elapsed_s if total.elapsed_s else 0.0
        left_s = total.elapsed_s * (count - total.seeds) / total.seeds
        click.echo(
            f"{total.seeds} of {count} seeds, {total.rounds} rounds, {rate:.0f} rounds/s, "
            f"{total.violations} violations, about {left_s:.0f} s left",
            err=True,
        )


def _say_shrinking(seed: int) -> None:
    click.echo(f"cutting the plan of seed {seed} down to what it takes; this takes a while", err=True)


def _report(total: SweepResult, conditions: dict[str, Condition], plan_file: Path | None, *, as_json: bool) -> None:
    figures = {
        "seeds": total.seeds,
        "violations": total.violations,
        "rounds_per_s": round(total.rounds / total.elapsed_s, 1) if total.elapsed_s else 0.0,
        "rounds": total.rounds,
        "blocks": total.blocks,
        "calls_acknowledged": total.acknowledged,
        "records": total.records,
        "records_never_given": total.records_never_given,
        "frames": total.frames,
        "virtual_s": round(total.virtual_s, 1),
        "cpu_s": round(total.cpu_s, 1),
        "elapsed_s": round(total.elapsed_s, 1),
        "trace": total.trace,
        "failed_seeds": [result.seed for result in total.failed],
    }
    for failure in total.failures:
        _print_failure(failure, plan_file)
    if as_json:
        print_json({"name": "sim", "ok": not total.violations, "figures": figures, "conditions": conditions})
        return
    console.print(
        f"{total.seeds} seeds, {total.rounds} rounds ({figures['rounds_per_s']} a second), "
        f"{total.acknowledged} calls acknowledged, {total.records} records "
        f"({total.records_never_given} of them given to no custodian), {total.virtual_s:.0f} s of virtual time: "
        f"{total.violations or 'no'} violations."
    )


def _print_failure(failure: Failure, plan_file: Path | None) -> None:
    from network.sim.plan_file import plan_to_toml  # noqa: PLC0415 - a node's code, only when it is needed

    plan = failure.plan
    folder = Path(tempfile.mkdtemp(prefix="blockrobot-sim-"))
    path = folder / f"seed-{failure.seed}.toml"
    write_new_file(path, plan_to_toml(failure.shrunk))
    click.echo(f"\nSeed {failure.seed} broke a promise:", err=True)
    for violation in failure.violations[:5]:
        click.echo(f"  {violation}", err=True)
    options = f"--nodes {plan.nodes} --rounds {plan.rounds} --byzantine {len(plan.byzantine)}"
    if plan.cpu:
        options = f"--profile flood --nodes {plan.nodes} --rounds {plan.rounds}"
    if plan.governance in {"grow", "custody"}:
        options = f"--profile {plan.governance} --rounds {plan.rounds}"
    replayed = f"--seeds {failure.seed} {options}" if plan_file is None else f"--plan {shlex.quote(str(plan_file))}"
    click.echo(f"replay:  blockrobot sim run {replayed} --trace", err=True)
    click.echo(f"shrunk:  blockrobot sim run --plan {shlex.quote(str(path))} --trace", err=True)
    click.echo(plan_to_toml(failure.shrunk), err=True)

"""`blockrobot experiment`: the paper's evaluation on an own network."""

from __future__ import annotations

import asyncio
import sys
from pathlib import Path

import click
import msgspec

from clients.sdk.terminal.terminal import EXIT_FAILED, FILE, FOLDER, command_output, console, home_folder, print_json
from consensus.errors import BlockRobotError
from network.cli.measure.cluster_option import with_cluster

DEFAULT_EXPERIMENT_BASE_PORT = 7572


@click.group()
def experiment() -> None:
    """Run the paper's experiments and one of ours, and make the same tables from anybody's event log.

    Example: blockrobot experiment run 1 --out experiments
    """


@experiment.command()
@click.argument("number", type=click.Choice(["1", "2", "3", "4", "5", "all"]))
@click.option(
    "--out", required=True, type=FOLDER, help="Where results go: a new folder, or one of earlier experiments."
)
@click.option(
    "--base-port", default=DEFAULT_EXPERIMENT_BASE_PORT, show_default=True, help="The first of ten ports a node."
)
@with_cluster()
@command_output
def run(number: str, out: Path, base_port: int, on: str, as_json: bool) -> None:
    """Run experiment NUMBER, or all five, each on a network of its own; exits 0 only if every check held.

    Example: blockrobot experiment run all --out experiments
    """
    from network.experiments.definitions import EXPERIMENTS  # noqa: PLC0415 - only when it is needed
    from network.experiments.progress import Progress  # noqa: PLC0415 - only when it is needed
    from network.experiments.run_all import RunOptions, run_experiments  # noqa: PLC0415 - only when it is needed

    chosen = [(item, item.load_scene()) for item in EXPERIMENTS if number in {"all", str(item.number)}]
    progress = Progress(as_json=as_json)
    place = out.resolve() if not out.is_symlink() else out.absolute()
    options = RunOptions(
        out=place,
        cache=home_folder() / "recordings",
        base_port=base_port,
        on_progress=progress.tell,
        show=progress.show,
        on=on,
    )
    try:
        result, outcomes = asyncio.run(run_experiments(chosen, options))
    except (KeyboardInterrupt, asyncio.CancelledError):
        click.echo("Ended; everything that was started is stopped.", err=True)
        sys.exit(EXIT_FAILED)
    if as_json:
        print_json(msgspec.to_builtins(result))
    else:
        held = sum(outcome.ok for outcome in outcomes)
        console.print(f"\n{held} of {len(outcomes)} experiments held. The report is {place / 'report.html'}.")
        if outcomes and result.conditions["drawn_by"] != "graphviz":
            refusal = BlockRobotError("DRAWING_UNAVAILABLE")
            click.echo(f"Process maps are plainer ones of our own. {refusal.code}: {refusal.next_step}", err=True)
    if not result.ok:
        sys.exit(EXIT_FAILED)


@experiment.command()
@click.argument("log", type=FILE)
@click.argument("second", required=False, type=FILE)
@click.option(
    "--out", type=FOLDER, help="Write tables, events and process maps into this folder, which must be new or empty."
)
@command_output
def compare(log: Path, second: Path | None, out: Path | None, as_json: bool) -> None:
    """Make figures, statistics tables and the process map from LOG, and beside it from a SECOND one.

    Example: blockrobot experiment compare published.txt events.jsonl --out tables
    """
    from network.experiments.comparison import (  # noqa: PLC0415 - only when it is needed
        prepare_new_folder,
        read_and_work_out,
        show_readings,
        write_reading,
    )

    readings = [read_and_work_out(path) for path in (log, second) if path is not None]
    answer = {"ok": True, "logs": [reading.as_json() for reading in readings]}
    refusals = []
    if out is not None:
        prepare_new_folder(out)
        for number, reading in enumerate(readings, 1):
            folder = out / f"log-{number}" if len(readings) > 1 else out
            refusal = write_reading(reading, folder)
            refusals += [] if refusal is None else [refusal]
        answer["out"] = str(out)
        answer["drawn_by"] = "blockrobot" if refusals else "graphviz"
    if as_json:
        print_json(answer)
        return
    click.echo(show_readings(readings))
    for refusal in refusals:
        click.echo(
            f"{refusal.detail} The SVG is a plainer one of our own.\n  {refusal.code}: {refusal.next_step}", err=True
        )

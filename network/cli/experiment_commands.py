"""`blockrobot experiment`: the paper's evaluation on a network of one's own. Must never exit 0 if an assertion failed."""

from __future__ import annotations

from pathlib import Path

import click

from clients.sdk.terminal import json_option, plain_errors, print_json


@click.group()
def experiment() -> None:
    """Run the paper's experiments, and make the same tables from anybody's event log.

    Example: blockrobot experiment compare published.txt events.jsonl
    """


@experiment.command()
@click.argument("log", type=click.Path(path_type=Path, dir_okay=False))
@click.argument("second", required=False, type=click.Path(path_type=Path, dir_okay=False))
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    help="Write tables, events and process maps into this folder, which must be new or empty.",
)
@json_option
@plain_errors
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

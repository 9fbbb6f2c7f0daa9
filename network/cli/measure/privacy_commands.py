"""`blockrobot privacy`: what the ledger reveals."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING

import click
import msgspec
from rich.table import Table

from clients.sdk.terminal.terminal import EXIT_FAILED, command_output, console, print_json
from network.cli.measure.cluster_option import with_cluster

if TYPE_CHECKING:
    from network.bench.conditions import Result
    from network.lab.privacy.attack_run import Figure

_SCHEMES = ("prototype", "salted", "peppered", "pepper_stolen", "ours")


@click.group()
def privacy() -> None:
    """Attack our own ledger, and see what it gives away.

    Example: blockrobot privacy attack --json
    """


@privacy.command()
@click.option("--seed", default=1, show_default=True, type=click.IntRange(0, 2**31), help="Who comes when.")
@click.option("--people", default=240, show_default=True, type=click.IntRange(8, 2_000), help="Who enrol.")
@click.option("--days", default=5, show_default=True, type=click.IntRange(2, 60), help="On which they are recorded.")
@click.option(
    "--uid-bits", default=20, show_default=True, type=click.IntRange(12, 30), help="Of a tag's UID, to enumerate."
)
@click.option("--processes", default=0, type=click.IntRange(0, 256), help="Processes (0: one for each core).")
@with_cluster("processes")
@command_output
def attack(seed: int, people: int, days: int, uid_bits: int, processes: int, on: str, as_json: bool) -> None:
    """Attack the prototype's way, salted and peppered hashes, and ours, on the records of the same people.

    Exits 0 only if every attack on ours is shown to be within 0.05 of guessing. What ours gives away by design stands
    apart, as limits. Takes a few minutes; fewer people make the bounds too wide to show anything. Uses scikit-learn
    if it is installed (extra `attack`).

    Example: blockrobot privacy attack --seed 2 --json
    """
    from network.lab.privacy.attack_run import AttackOptions, run_privacy_attack  # noqa: PLC0415 - a node's code, only when needed

    options = AttackOptions(people=people, days=days, seed=seed, serial_bits=uid_bits, processes=processes, on=on)
    result = run_privacy_attack(options, _Teller())
    if as_json:
        print_json(msgspec.to_builtins(result))
    else:
        for table in _tables(result):
            console.print(table)
    if not result.ok:
        sys.exit(EXIT_FAILED)


class _Teller:
    def __init__(self) -> None:
        self._started = time.monotonic()

    def __call__(self, line: str) -> None:
        click.echo(f"{time.monotonic() - self._started:5.0f} s  {line}", err=True)


def _tables(result: Result[dict[str, Figure]]) -> list[Table]:
    figures = result.figures
    side = Table(title=f"{result.name}: {'ok' if result.ok else 'FAILED'}", title_justify="left")
    side.add_column("attack", no_wrap=True)
    for scheme in _SCHEMES:
        side.add_column(scheme.replace("_", " "), justify="right")
    side.add_column("guessing", justify="right")
    limits = Table(title="given away by design", title_justify="left")
    for heading in ("limit", "success", "guessing"):
        limits.add_column(heading, justify="left" if heading == "limit" else "right")
    end = "_ours_success_rate"
    for name in (name.removesuffix(end) for name in figures if name.endswith(end)):
        cells = [str(figures.get(f"{name}_{scheme}_success_rate", "")) for scheme in _SCHEMES]
        side.add_row(name, *cells, str(figures[f"{name}_ours_guess_rate"]))
    for name in (name.removesuffix("_success_rate") for name in figures if name.startswith("limit_")):
        if f"{name}_guess_rate" in figures:
            success = figures[f"{name}_success_rate"]
            cells = ["" if success is None else str(success), str(figures[f"{name}_guess_rate"])]
            limits.add_row(name.removeprefix("limit_"), *cells)
    rest = Table(title="searches and conditions", title_justify="left", show_header=False)
    for name, value in {**figures, **result.conditions}.items():
        if not name.endswith(("_rate", "_bound", "_trials")):
            rest.add_row(name, str(value))
    return [side, limits, rest]

"""`blockrobot lab`: what a lecture shows: hosts of their own, and a year of a hospital."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from clients.sdk.terminal.safe_output import escape
from clients.sdk.terminal.terminal import EXIT_FAILED, FOLDER, command_output, console, print_answer
from network.cli.measure.lab_answers import HostStoriesAnswer, HostStoryAnswer

if TYPE_CHECKING:
    from network.lab.year.figures import HospitalYearAnswer

YEAR_DAYS_MAX_COUNT = 3_660
YEAR_MEMBERS_MAX_COUNT = 100_000
YEAR_ROBOTS_MAX_COUNT = 1_000
YEAR_CUSTODIANS_MAX_COUNT = 21


@click.group()
def lab() -> None:
    """Play stories of a network on hosts of its own, and a hospital's year in a day.

    Example: sudo blockrobot lab hosts liar
    """


@lab.command()
@click.argument("story", required=False)
@command_output
def hosts(story: str | None, as_json: bool) -> None:
    """Found a network of four organisations on hosts of their own, and play STORY there; without it, list the stories.

    Needs Linux, root and iproute2. The hosts are network namespaces of this machine, and are removed at the end. What
    happens is told line by line, on standard error. Exits 1 if something did not go as it should. Some stories use nginx.

    \b
    Example: blockrobot lab hosts
    Example: sudo blockrobot lab hosts upgrade --json
    """
    from network.bench.processes import leave_by_exit  # noqa: PLC0415 - a node's code, only when it is needed
    from network.lab.hosts.catalogue import STORIES, play_story  # noqa: PLC0415

    if story is None:
        if as_json:
            print_answer(HostStoriesAnswer(stories={name: each.summary for name, each in STORIES.items()}))
        else:
            click.echo("\n".join(f"{name:10} {each.summary}" for name, each in STORIES.items()))
        return
    if story not in STORIES:
        raise click.UsageError(f"There is no story {story!r}; there are {', '.join(STORIES)}.")
    with leave_by_exit():
        result = play_story(story, lambda line: click.echo(line, err=True))
    if as_json:
        answer = HostStoryAnswer(
            name=result.name,
            failures=result.failures,
            figures=msgspec.to_builtins(result.figures),
            conditions=dict(result.conditions),
        )
        print_answer(answer, ok=result.ok)
    else:
        console.print(f"{result.name}: {'all went as it should' if result.ok else 'FAILED'}")
        for failure in result.failures:
            click.echo(f"  {failure}")
    if not result.ok:
        sys.exit(EXIT_FAILED)


@lab.command()
@click.option("--days", default=30, show_default=True, type=click.IntRange(2, YEAR_DAYS_MAX_COUNT), help="Days.")
@click.option(
    "--members", default=2_000, show_default=True, type=click.IntRange(1, YEAR_MEMBERS_MAX_COUNT), help="Patients."
)
@click.option("--robots", default=20, show_default=True, type=click.IntRange(1, YEAR_ROBOTS_MAX_COUNT), help="Robots.")
@click.option(
    "--custodians",
    default=3,
    show_default=True,
    type=click.IntRange(1, YEAR_CUSTODIANS_MAX_COUNT),
    help="Custodians, each with its own database and erase keys.",
)
@click.option(
    "--seed", default=1, show_default=True, type=click.IntRange(0), help="The same seed makes the same chain."
)
@click.option("--out", type=FOLDER, default=Path("blockrobot-year"), show_default=True, help="For all that is made.")
@command_output
def year(days: int, members: int, robots: int, custodians: int, seed: int, out: Path, as_json: bool) -> None:
    """Play a hospital's days one after the other: visits, consents, shares, erasures, expiries, changes of keys.

    Contracts, ledger and custodians are the real ones, in one process and under a clock that the program drives. At the
    end of each month (30 days) chain, custodians and plan are held against one another, and what is gone is hunted for;
    at the end members audit their visits, and a node starts from a snapshot and one from a backup. Sizes and costs by
    month are in report.html. Progress goes to standard error. Exits 1 if something did not go as it should.

    \b
    Example: blockrobot lab year
    Example: blockrobot lab year --days 365 --out /srv/year --json
    """
    from network.bench.processes import run_to_end  # noqa: PLC0415 - a node's code, only when it is needed
    from network.lab.year.out_folder import reserved_out, write_results  # noqa: PLC0415
    from network.lab.year.plan import YearOptions  # noqa: PLC0415
    from network.lab.year.run_year import run_year  # noqa: PLC0415

    options = YearOptions(days, members, robots, custodians, seed)
    out = out.absolute()
    with reserved_out(out):
        answer = run_to_end(run_year(options, out, lambda line: click.echo(line, err=True)))
        write_results(out, answer)
    if as_json:
        print_answer(answer, ok=not answer.failures)
    else:
        _print_year(answer)
    if answer.failures:
        sys.exit(EXIT_FAILED)


def _print_year(answer: HospitalYearAnswer) -> None:
    last = answer.months[-1]
    console.print(
        f"{last.days} days: {last.visits:,} visits, {last.records:,} records, {last.erased:,} of them gone; "
        f"{last.blocks:,} blocks with {last.transactions:,} transactions. {answer.days_a_minute:g} days a minute."
    )
    for failure in answer.failures:
        console.print(escape(f"  {failure}"))
    held = "Everything held." if not answer.failures else "Not everything held."
    console.print(escape(f"{held} The report: {answer.report}"))

"""`blockrobot lab`: what a lecture shows, on hosts of their own."""

from __future__ import annotations

import sys

import click
import msgspec

from clients.sdk.terminal.terminal import EXIT_FAILED, command_output, console, print_answer
from network.cli.measure.lab_answers import HostStoriesAnswer, HostStoryAnswer


@click.group()
def lab() -> None:
    """Play stories of a network whose nodes are on hosts of their own. Needs Linux, root and iproute2.

    Example: sudo blockrobot lab hosts liar
    """


@lab.command()
@click.argument("story", required=False)
@command_output
def hosts(story: str | None, as_json: bool) -> None:
    """Found a network of four organisations on hosts of their own, and play STORY there; without it, list the stories.

    The hosts are network namespaces of this machine, and are removed at the end. What happens is told line by line, on
    standard error. Exits 1 if something did not go as it should. Some stories use nginx.

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

"""`blockrobot robot topics`: what a recording holds. Must never print what a message of it says."""

from __future__ import annotations

from pathlib import Path

import click

from clients.robot.sources.listing import Listed, draft_topics, list_topics, next_steps
from clients.robot.sources.recording import Recording
from clients.sdk.terminal import console, json_option, plain_errors, print_json
from consensus.errors import BlockRobotError


@click.command()
@click.argument("recording", type=click.Path(path_type=Path))
@click.option(
    "--draft",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Write a topics file to start from; an existing file is left alone.",
)
@json_option
@plain_errors
def topics(recording: Path, draft: Path | None, as_json: bool) -> None:
    """List a recording's topics, types, counts and rates, and what each could be.

    Example: blockrobot robot topics recording.mcap --draft topics.toml
    """
    opened = Recording(recording)
    listed = list_topics(opened)
    steps = next_steps(opened, listed)
    if draft is not None:
        _write(draft, draft_topics(opened, listed))
    if as_json:
        rows = [_row(item) for item in listed]
        print_json(
            {
                "ok": True,
                "topics": rows,
                "broken": opened.broken or None,
                "draft": str(draft) if draft else None,
                "next_steps": steps,
            }
        )
        return
    for item in listed:
        guess = f"  could be {' or '.join(item.could_be)}" if item.could_be else ""
        kind = f"{item.figures.type} {item.encoding}".strip()
        console.print(f"{item.figures.name}  {kind}  {item.figures.count} messages, {item.figures.rate_hz}/s{guess}")
    if opened.broken:
        console.print(f"The recording breaks off: {opened.broken} What stands before the break can be used.")
    for step in steps:
        console.print(step, markup=False)
    if draft is not None:
        console.print(
            f"A draft is in {draft}. Next: check it, then blockrobot robot replay {recording} --topics {draft}."
        )


def _write(path: Path, text: str) -> None:
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise BlockRobotError("TOPICS_INVALID", f"{path} exists already, and is left as it is.") from None


def _row(item: Listed) -> dict[str, object]:
    figures = item.figures
    return {
        "topic": figures.name,
        "type": figures.type,
        "count": figures.count,
        "rate_hz": figures.rate_hz,
        "encoding": item.encoding or None,
        "could_be": list(item.could_be),
    }

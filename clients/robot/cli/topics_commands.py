"""`blockrobot robot topics`: topics of a recording or a running robot."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from clients.robot.cli.live_options import look_options, make_feeds
from clients.robot.cli.robot_answers import RobotTopic, RobotTopicsAnswer
from clients.robot.cli.robot_choice import ROBOT_COMMAND, name_robot
from clients.robot.sources.live.live_sampling import Sample
from clients.robot.sources.recordings.recording import Recording
from clients.robot.sources.recordings.topic_listing import ListedTopic, draft_topics, list_topics, next_steps
from clients.sdk.new_files import write_new_file
from clients.sdk.terminal.terminal import FILE, command_output, console, print_answer, print_line


@click.command()
@click.argument("recording", type=click.Path(path_type=Path), required=False)
@look_options(
    source_help="List what the robot's middleware carries now, instead of a RECORDING.",
    seconds_help="Listen to the robot's middleware for so long.",
)
@click.option("--draft", type=FILE, help="Write a topics file to start from; an existing file is left alone.")
@command_output
def topics(recording: Path | None, draft: Path | None, as_json: bool, **options: Any) -> None:
    """List the topics of a recording or of a running robot: types, counts and rates, and what each could be.

    Example: blockrobot robot topics recording.mcap --draft topics.toml
    """
    opened = _open(recording, options)
    broken = opened.broken if isinstance(opened, Recording) else ""
    listed = list_topics(opened)
    steps = next_steps(opened, listed)
    if draft is not None:
        write_new_file(draft, draft_topics(opened, listed))
    if as_json:
        answer = RobotTopicsAnswer(
            topics=[_topic(item) for item in listed],
            broken=broken or None,
            draft=str(draft) if draft else None,
            next_steps=steps,
        )
        print_answer(answer)
        return
    for item in listed:
        guess = f"  could be {' or '.join(item.could_be)}" if item.could_be else ""
        kind = f"{item.figures.type} {item.encoding}".strip()
        print_line(f"{item.figures.name}  {kind}  {item.figures.count} messages, {item.figures.rate_hz}/s{guess}")
    if broken:
        print_line(f"The recording breaks off: {broken} What stands before the break can be used.")
    for step in steps:
        print_line(step)
    if draft is not None:
        use = f"replay {recording}" if recording else f"run --source {options['source']} --viewpoint NAME"
        print_line(name_robot(f"A draft is in {draft}. Next: check it, then {ROBOT_COMMAND} {use} --topics {draft}."))
    elif not listed:
        console.print("Nothing is advertised. Next: start the camera's and the reader's drivers, and list again.")


def _open(recording: Path | None, options: dict[str, Any]) -> Recording | Sample:
    if (recording is None) == (options["source"] is None):
        raise click.UsageError("Name a RECORDING, or with --source the robot's middleware; not both.")
    if recording is not None:
        return Recording(recording)
    sample = Sample(make_feeds(options["source"], options)[0])
    sample.listen(options["seconds"])
    return sample


def _topic(item: ListedTopic) -> RobotTopic:
    figures = item.figures
    return RobotTopic(
        topic=figures.name,
        type=figures.type,
        count=figures.count,
        rate_hz=figures.rate_hz,
        encoding=item.encoding or None,
        could_be=list(item.could_be),
    )

"""Options that describe a recording's topics; only the `--tags` topic's type is looked up."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from clients.robot.sources.messages.topics import load_topics, tags_by_type, with_topic
from clients.robot.sources.recordings.bag_source import BagSource, EmptyScene
from clients.robot.sources.recordings.recording import Recording
from clients.sdk.terminal.terminal import FILE


def topic_options(command: Any) -> Any:
    for option in (
        click.option("--topics", "topics_file", type=FILE, help="A file that names topics and fields."),
        click.option("--depth", metavar="TOPIC", help="The topic of depth images."),
        click.option(
            "--tags", metavar="TOPIC", help="The topic of tag readings (RfidDetection, or String for a bare UID)."
        ),
    ):
        command = option(command)
    return command


def source_options(command: Any) -> Any:
    for option in (
        click.option("--empty-topic", metavar="TOPIC", help="The topic of frames without people."),
        click.option(
            "--empty-seconds",
            metavar="A..B",
            help="Take the frames without people from these seconds of the depth topic.",
        ),
        click.option(
            "--empty",
            "empty_recording",
            type=click.Path(path_type=Path),
            help="Take the frames without people from another recording.",
        ),
    ):
        command = option(command)
    return topic_options(command)


def open_recording(path: Path, options: dict[str, Any]) -> BagSource:
    """Raises UsageError, BAG_*, TOPICS_INVALID."""
    chosen = load_topics(options["topics_file"])
    tags = None
    if options["tags"]:
        known = Recording(path, chosen.definitions).topics.get(options["tags"])
        # A topic that is not there is refused by the source, which lists what is.
        tags = (tags_by_type(options["tags"], known.type if known else "std_msgs/msg/String"),)
    chosen = with_topic(chosen, depth=options["depth"], tags=tags, empty=options["empty_topic"])
    empty = EmptyScene(options["empty_recording"], _stretch(options["empty_seconds"]))
    return BagSource(path, topics=chosen, empty=empty)


def _stretch(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    first, mark, last = text.partition("..")
    try:
        stretch = (float(first), float(last))
    except ValueError:
        mark = ""
        stretch = (0.0, 0.0)
    if not mark or not 0 <= stretch[0] < stretch[1]:
        raise click.UsageError("--empty-seconds takes a stretch in seconds from the first frame, as 0..5.")
    return stretch

"""A robot's live sources, and their options."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import click

from clients.robot.cli.run_report import clear_line
from clients.robot.sources.live import llrp, ros1, ros2, zenoh
from clients.robot.sources.live.live_feed import Feed
from clients.robot.sources.live.live_source import LiveSource, OnProgress
from clients.robot.sources.messages.topics import (
    TagTopic,
    Topics,
    load_topics,
    rooted,
    tags_by_type,
    with_rooted_names,
    with_topic,
)
from consensus.errors import BlockRobotError
from consensus.visible_text import escape_controls

SYNTHETIC = "synthetic"
LOOK_DEFAULT_S = 3.0


@dataclass(frozen=True, slots=True)
class FeedKind:
    """An adapter: `make` builds feeds, `options` are its click options."""

    make: Callable[[Mapping[str, Any]], Sequence[Feed]]
    options: tuple[Callable[[Any], Any], ...] = ()


CAMERAS: dict[str, FeedKind] = {
    "ros1": FeedKind(ros1.make_feeds, ros1.OPTIONS),
    "ros2": FeedKind(ros2.make_feeds, ros2.OPTIONS),
    "zenoh": FeedKind(zenoh.make_feeds, zenoh.OPTIONS),
}
"""What `--source` can name: middleware that brings the camera's frames, and tag readings if the robot has them."""

BESIDE: dict[str, FeedKind] = {
    "llrp": FeedKind(llrp.make_feeds, llrp.OPTIONS),
}
"""Readers that bring sightings alone, beside any of the others; they make no feed unless their option is given."""


def make_feeds(source: str, options: Mapping[str, Any]) -> list[Feed]:
    """Return feeds of `source` and of readers beside it."""
    kinds = [CAMERAS[source], *BESIDE.values()]
    return [feed for kind in kinds for feed in kind.make(options)]


def camera_options(command: Any) -> Any:
    return _with_options(command, CAMERAS)


def live_options(command: Any) -> Any:
    return _with_options(camera_options(command), BESIDE)


def _with_options(command: Any, kinds: Mapping[str, FeedKind]) -> Any:
    for kind in kinds.values():
        for option in kind.options:
            command = option(command)
    return command


def source_option(*others: str, **settings: Any) -> Callable[[Any], Any]:
    return click.option("--source", type=click.Choice([*others, *CAMERAS]), **settings)


def look_options(*, source_help: str, seconds_help: str) -> Callable[[Any], Any]:
    def with_options(command: Any) -> Any:
        seconds = click.option(
            "--seconds", default=LOOK_DEFAULT_S, show_default=True, type=click.FloatRange(0.5, 60), help=seconds_help
        )
        return source_option(help=source_help)(seconds(camera_options(command)))

    return with_options


def live_topics(options: Mapping[str, Any]) -> Topics:
    """Raises TOPICS_INVALID."""
    return with_rooted_names(with_topic(load_topics(options["topics_file"]), depth=options["depth"]))


def open_live(options: Mapping[str, Any], on_progress: OnProgress) -> LiveSource:
    """Raises TOPICS_INVALID, FEED_UNREACHABLE, MIDDLEWARE_MISSING."""
    feeds = make_feeds(options["source"], options)
    tags: tuple[TagTopic, ...] | None = None
    if options["tags"]:
        topic, advertised = rooted(options["tags"]), feeds[0].topics()
        if topic not in advertised:
            raise BlockRobotError(
                "TOPICS_INVALID",
                f"{topic} is not advertised now, so that its type is not known: start what publishes it, or "
                "name it in a topics file.",
            )
        tags = (tags_by_type(topic, advertised[topic]),)
    elif len(feeds) > 1 and not options["topics_file"]:
        tags = ()  # a reader of its own brings the readings
    return LiveSource(feeds, with_topic(live_topics(options), tags=tags), on_progress)


def open_camera(options: Mapping[str, Any], on_progress: OnProgress) -> LiveSource:
    """The camera alone. Raises as `open_live`."""
    alone = replace(live_topics(options), tags=(), rgb="", labels=None, audio=None)
    return LiveSource(make_feeds(options["source"], options)[:1], alone, on_progress)


def notice_teller(*, as_json: bool) -> OnProgress:
    def on_progress(sentence: str) -> None:
        if not as_json:
            clear_line()
        click.echo(json.dumps({"notice": sentence}) if as_json else escape_controls(sentence, ""), err=True)

    return on_progress

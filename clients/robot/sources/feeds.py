"""The live feeds that a robot can listen to, a line each, and the options that each adds to the commands that use them.

The one place that knows every adapter. Must never import a middleware: adapters do that when they are used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from clients.robot.sources.feed import Feed

Option = Callable[[Any], Any]


@dataclass(frozen=True, slots=True)
class FeedKind:
    """An adapter: `make` builds its feeds of a command's options, `options` are the click options that it adds."""

    make: Callable[[Mapping[str, Any]], Sequence[Feed]]
    options: tuple[Option, ...] = ()


CAMERAS: dict[str, FeedKind] = {}
"""What `--source` can name: middleware that brings the camera's frames, and tag readings if the robot has them."""

BESIDE: dict[str, FeedKind] = {}
"""Readers that bring sightings alone, beside any of the others; they make no feed unless their option is given."""


def feed_options(command: Any) -> Any:
    """Add the options of every feed."""
    for kind in [*CAMERAS.values(), *BESIDE.values()]:
        for option in kind.options:
            command = option(command)
    return command


def make_feeds(source: str, options: Mapping[str, Any]) -> list[Feed]:
    """Return the feeds that a command's options describe: those of `source`, and of the readers beside it."""
    kinds = [CAMERAS[source], *BESIDE.values()]
    return [feed for kind in kinds for feed in kind.make(options)]

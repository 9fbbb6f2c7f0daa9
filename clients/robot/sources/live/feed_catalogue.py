"""The only catalogue of live feeds and their command options."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from clients.robot.sources.live import llrp, ros1, ros2, zenoh
from clients.robot.sources.live.live_feed import Feed

Option = Callable[[Any], Any]


@dataclass(frozen=True, slots=True)
class FeedKind:
    """An adapter: `make` builds feeds, `options` are its click options."""

    make: Callable[[Mapping[str, Any]], Sequence[Feed]]
    options: tuple[Option, ...] = ()


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

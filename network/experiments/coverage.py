"""Which frames the event log says became whose, tag by tag.

A log's aliases are drawn for each run and name nobody. Whose tag one is, its frames say: they are held against those
that the scenario's own readings cover.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Set
from dataclasses import dataclass, field

from clients.robot.run.event_log import BLOCKCHAIN_TRANSACTION, IMAGE_PAIRED, IMAGE_WITHHELD
from network.experiments.pages.event_table import EventTable


@dataclass(slots=True)
class TagFrames:
    """The numbers of one tag's frames: paired with it, final on the chain, withheld."""

    paired: set[int] = field(default_factory=set)
    kept: set[int] = field(default_factory=set)
    withheld: set[int] = field(default_factory=set)

    @property
    def lost(self) -> set[int]:
        """Frames that were paired and of which nothing more is told."""
        return self.paired - self.kept - self.withheld

    @property
    def is_settled(self) -> bool:
        """Whether every paired frame, and no other, was either kept or withheld."""
        return self.paired == self.kept | self.withheld and not self.kept & self.withheld


def frames_by_tag(table: EventTable) -> dict[str, TagFrames]:
    """Return the frames of each tag to which the log gives any."""
    tags: dict[str, TagFrames] = {}
    for event in table.events:
        if not event.alias or event.sequence is None:
            continue
        frames = tags.setdefault(event.alias, TagFrames())
        if event.activity == IMAGE_PAIRED:
            frames.paired.add(event.sequence)
        elif event.activity == BLOCKCHAIN_TRANSACTION:
            frames.kept.add(event.sequence)
        elif event.activity == IMAGE_WITHHELD:
            frames.withheld.add(event.sequence)
    return tags


def are_covered_frames(tags: Iterable[TagFrames], expected: Mapping[str, Set[int]]) -> bool:
    """Tell whether the tags have exactly the frames that the scenario says, each person's at one tag."""
    return sorted(sorted(tag.paired) for tag in tags) == sorted(sorted(own) for own in expected.values() if own)


def total(sets: Iterable[Set[int]]) -> int:
    """Return how many frames and owners these are."""
    return sum(len(one) for one in sets)

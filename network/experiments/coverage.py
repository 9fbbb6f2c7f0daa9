"""Frames per owner by the event log, tag by tag."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Set
from dataclasses import dataclass, field

from clients.robot.run.event_log import BLOCKCHAIN_TRANSACTION, IMAGE_PAIRED, IMAGE_WITHHELD
from network.experiments.pages.event_table import EventTable


@dataclass(slots=True)
class TagFrames:
    """One tag's frame numbers: paired, final on the chain, withheld."""

    paired: set[int] = field(default_factory=set)
    kept: set[int] = field(default_factory=set)
    withheld: set[int] = field(default_factory=set)

    @property
    def lost(self) -> set[int]:
        """Return the paired frames that were neither kept nor withheld."""
        return self.paired - self.kept - self.withheld

    @property
    def is_settled(self) -> bool:
        return self.paired == self.kept | self.withheld and not self.kept & self.withheld


def frames_by_tag(table: EventTable) -> dict[str, TagFrames]:
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
    """Return whether tags and people match one to one with exactly the scenario's frames."""
    return sorted(sorted(tag.paired) for tag in tags) == sorted(sorted(own) for own in expected.values() if own)


def total(sets: Iterable[Set[int]]) -> int:
    return sum(len(one) for one in sets)

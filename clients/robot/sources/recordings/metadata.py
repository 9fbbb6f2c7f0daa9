"""Reads metadata.yaml of a rosbag2 folder: the library loads any YAML, in which aliases and tags multiply what is there."""

from __future__ import annotations

import functools
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.composer import Composer
from ruamel.yaml.events import AliasEvent

METADATA_MAX_BYTES = 1024 * 1024
"""200 topics of three publishers each take a quarter of it, a day in files of a minute a third."""
METADATA_NODES_MAX_COUNT = 50_000
"""200 topics of three publishers each take half of them. A node takes up to 0.1 ms to be read, however short it is."""
METADATA_MAX_DEPTH = 16
"""Recorders write up to nine levels."""


class ForeignMetadataError(Exception):
    """No recorder wrote such a metadata.yaml."""


class PlainComposer(Composer):
    """Refuses what no recorder writes before anything is made of it."""

    nodes_count = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        event = self.parser.peek_event()
        self.nodes_count += 1
        if self.nodes_count > METADATA_NODES_MAX_COUNT:
            raise ForeignMetadataError(f"Its metadata.yaml has more than {METADATA_NODES_MAX_COUNT} values.")
        if self.depth >= METADATA_MAX_DEPTH:
            raise ForeignMetadataError(f"Its metadata.yaml is nested in more than {METADATA_MAX_DEPTH} levels.")
        is_plain = not isinstance(event, AliasEvent) and event.anchor is None and event.tag is None
        if not is_plain or getattr(event, "value", "") == "<<":
            raise ForeignMetadataError(
                "Its metadata.yaml has an alias, an anchor, a tag or a merge key: no recorder did that."
            )
        return super().compose_node(parent, index)


@functools.lru_cache(maxsize=1)
def read_metadata(text: str) -> Any:
    """Once for all passes over a recording. Raises ForeignMetadataError, YAMLError."""
    loader = YAML(typ="safe", pure=True)
    loader.Composer = PlainComposer
    return loader.load(text)


class BoundedYaml:
    """What the library takes for its loader."""

    load = staticmethod(read_metadata)

    def __init__(self, typ: str) -> None:
        pass

"""Check topics file paths against the recorded message types."""

from __future__ import annotations

from collections.abc import Iterator

from clients.robot.sources.messages.message_types import MessageTypes
from clients.robot.sources.topics import Topics

FIELDS_SHOWN_MAX_COUNT = 24


def missing_field(topics: Topics, topic: str, type_name: str, types: MessageTypes) -> str:
    """Return the setting with a missing field, as a sentence, or empty."""
    for key, path in _named(topics, topic):
        if not types.has_path(type_name, path):
            words = ', and it is neither "front" nor "back"' if key.endswith(".facing") else ""
            return f'{key} = "{path}" is no field of {type_name}{words}. It has {shown_fields(types, type_name)}.'
    return ""


def shown_fields(types: MessageTypes, type_name: str) -> str:
    paths = own_paths(types, type_name)
    more = f" and {len(paths) - FIELDS_SHOWN_MAX_COUNT} more" if len(paths) > FIELDS_SHOWN_MAX_COUNT else ""
    return ", ".join(paths[:FIELDS_SHOWN_MAX_COUNT]) + more


def own_paths(types: MessageTypes, type_name: str) -> list[str]:
    return [path for path in types.paths(type_name) if not path.startswith("header.")]


def _named(topics: Topics, topic: str) -> Iterator[tuple[str, str]]:
    for place, tags in enumerate(topics.tags):
        if tags.topic == topic:
            yield from ((f"tags[{place}].{key}", path) for key, path in tags.map.named_paths.items())
    if topics.labels is not None and topics.labels.topic == topic:
        yield "labels.text", topics.labels.text
        if topics.labels.confidence:
            yield "labels.confidence", topics.labels.confidence
    if topics.audio is not None and topics.audio.topic == topic:
        yield "audio.data", topics.audio.data

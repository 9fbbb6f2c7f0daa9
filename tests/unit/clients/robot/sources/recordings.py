"""Makes recordings for tests: any format, any topics, messages given as (time in ms, fields)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from clients.robot.sensing.message_names import SIGHTING_DEFINITION, SIGHTING_TYPE

FORMATS = ("ros1", "sqlite3", "mcap")
START_MS = 1_700_000_000_000


@dataclass(frozen=True)
class Topic:
    """A topic's name, its type, and its messages: (ms after the start, values of the type's fields)."""

    name: str
    type: str
    messages: Sequence[tuple[int, Mapping[str, Any]]]


def types(kind: str, definitions: Mapping[str, str]) -> Typestore:
    store = get_typestore(Stores.ROS1_NOETIC if kind == "ros1" else Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(SIGHTING_DEFINITION, SIGHTING_TYPE))
    for name, text in definitions.items():
        store.register(get_types_from_msg(text, name))
    return store


def build(store: Typestore, type_name: str, values: Mapping[str, Any]) -> Any:
    """Return a message, fields that are not given as zeros; a nested message is given as a mapping."""
    made = {}
    for name, (_, what) in store.fielddefs[type_name][1]:
        value = values.get(name)
        if isinstance(what, str):
            made[name] = build(store, what, value or {})
        elif value is not None and isinstance(value, list) and isinstance(value[0], dict):
            made[name] = [build(store, what[0][1], entry) for entry in value]
        else:
            made[name] = _zero(what) if value is None else value
    return store.types[type_name](**made)


def _zero(what: Any) -> Any:
    kind = what[0]
    if isinstance(kind, tuple):
        return [] if kind[1] == ("string", 0) or isinstance(kind[1], str) else np.zeros(0, np.uint8)
    return "" if kind == "string" else 0


def stamp(at_ms: int) -> dict[str, Any]:
    return {"stamp": {"sec": at_ms // 1000, "nanosec": at_ms % 1000 * 1_000_000}, "frame_id": ""}


def image(
    pixels: npt.NDArray[Any], encoding: str = "16UC1", at_ms: int = START_MS, *, big: bool = False, pad: int = 0
) -> dict[str, Any]:
    """Return the fields of an Image; `pad` bytes of noise stand behind each row."""
    ordered = pixels.astype(pixels.dtype.newbyteorder(">" if big else "<")) if pixels.itemsize > 1 else pixels
    height, width = pixels.shape[:2]
    rows = np.ascontiguousarray(ordered).view(np.uint8).reshape(height, -1)
    data = np.hstack([rows, np.full((height, pad), 0xA5, np.uint8)]).reshape(-1)
    return {
        "header": stamp(at_ms),
        "height": height,
        "width": width,
        "encoding": encoding,
        "is_bigendian": int(big),
        "step": rows.shape[1] + pad,
        "data": data,
    }


def record(path: Path, kind: str, topics: Sequence[Topic], definitions: Mapping[str, str] | None = None) -> Path:
    """Write a recording of one of `FORMATS` and return where it is."""
    store = types(kind, definitions or {})
    rows = sorted(
        ((at, place, topic, values) for place, topic in enumerate(topics) for at, values in topic.messages),
        key=lambda row: (row[0], row[1]),
    )
    target = path.with_suffix(".bag") if kind == "ros1" else path
    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    opened: Any = Ros1Writer(target) if kind == "ros1" else Ros2Writer(target, version=9, storage_plugin=plugin)
    with opened as writer:
        connections = [writer.add_connection(topic.name, topic.type, typestore=store) for topic in topics]
        for at, place, topic, values in rows:
            message = build(store, topic.type, values)
            pack = store.serialize_ros1 if kind == "ros1" else store.serialize_cdr
            writer.write(connections[place], (START_MS + at) * 1_000_000, bytes(pack(message, topic.type)))
    return target


def storage_file(recording: Path) -> Path:
    """Return the one file of a recording that holds its messages."""
    if recording.is_file():
        return recording
    (file,) = [path for path in recording.iterdir() if path.suffix in (".mcap", ".db3")]
    return file

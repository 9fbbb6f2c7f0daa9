"""Robot names and places, published on the chain by organisations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from consensus.visible_text import find_hidden

ROBOT_NAME_MAX_CHARS = 32
ROBOT_PLACE_MAX_CHARS = 48


@dataclass(frozen=True, slots=True)
class RobotName:
    """A robot's name and place, possibly empty."""

    name: str
    place: str


def read_robot_name(value: Any) -> RobotName | None:
    if not isinstance(value, dict):
        return None
    name, place = value.get("name"), value.get("place")
    if not isinstance(name, str) or not isinstance(place, str) or not name:
        return None
    if len(name) > ROBOT_NAME_MAX_CHARS or len(place) > ROBOT_PLACE_MAX_CHARS:
        return None
    return None if any(True for _ in find_hidden(name + place)) else RobotName(name, place)

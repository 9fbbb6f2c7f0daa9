"""What the contract `consent` keeps of a person, read: choices as steps.

A choice is about one purpose and one sensor; its steps say from which height on what holds (see the contract).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

GIVEN = "given"
STEPS_MAX_COUNT = 2
_STEP_TYPES = [int, str, int, int, int, bytes]


@dataclass(frozen=True, slots=True)
class Step:
    """From `height` on `status` holds. `since_ms`: when a no was said, or since when a consent holds without a break.

    Pictures may be taken from `from_ms` to before `until_ms`, chain time in ms; 0 is no bound. `mandate` is the id of the
    mandate under which it was said for the person; empty if she said it herself.
    """

    height: int
    status: str
    since_ms: int
    from_ms: int
    until_ms: int
    mandate: bytes = b""


Choices = dict[tuple[str, str], tuple[Step, ...]]


def read_choices(value: Any) -> Choices:
    """Return the steps by (purpose, sensor) of a proved state value; None is nothing said.

    What a later version of the contract may write in another form is left out: that is no consent.
    """
    return dict(_each(value))


def _each(value: Any) -> Iterator[tuple[tuple[str, str], tuple[Step, ...]]]:
    for purpose, sensors in value.items() if isinstance(value, dict) else ():
        for sensor, steps in sensors.items() if isinstance(sensors, dict) else ():
            if isinstance(steps, list) and steps and all(map(_is_step, steps)):
                yield (purpose, sensor), tuple(Step(*step) for step in steps)


def _is_step(step: Any) -> bool:
    return isinstance(step, list) and [type(part) for part in step] == _STEP_TYPES


def find_consent(steps: tuple[Step, ...], height: int) -> Step | None:
    """Return the consent that holds at a height, or None. A no counts as soon as it is seen, before its height too."""
    held = None
    for step in steps:
        if step.height <= height:
            held = step
        elif step.status != GIVEN:
            return None
    return held if held is not None and held.status == GIVEN else None

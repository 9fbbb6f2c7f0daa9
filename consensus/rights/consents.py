"""Reads the contract `consent`: height-dependent steps per purpose and sensor."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

GIVEN = "given"
STEPS_MAX_COUNT = 2
_STEP_TYPES = [int, str, int, int, int, bytes]


@dataclass(frozen=True, slots=True)
class Step:
    """From `height` on `status` holds; `since_ms`: refusal time, or start of unbroken consent.

    Recording is allowed from `from_ms` to before `until_ms` (chain ms, 0 unbounded). `mandate` is its id, empty for the
    person themselves.
    """

    height: int
    status: str
    since_ms: int
    from_ms: int
    until_ms: int
    mandate: bytes = b""


Choices = dict[tuple[str, str], tuple[Step, ...]]


def read_choices(value: Any) -> Choices:
    return dict(_each(value))


def _each(value: Any) -> Iterator[tuple[tuple[str, str], tuple[Step, ...]]]:
    for purpose, sensors in value.items() if isinstance(value, dict) else ():
        for sensor, steps in sensors.items() if isinstance(sensors, dict) else ():
            if isinstance(steps, list) and steps and all(map(_is_step, steps)):
                yield (purpose, sensor), tuple(Step(*step) for step in steps)


def _is_step(step: Any) -> bool:
    return isinstance(step, list) and [type(part) for part in step] == _STEP_TYPES


def find_consent(steps: tuple[Step, ...], height: int) -> Step | None:
    """Return the consent at a height, or None; refusals count at once, even earlier."""
    held = None
    for step in steps:
        if step.height <= height:
            held = step
        elif step.status != GIVEN:
            return None
    return held if held is not None and held.status == GIVEN else None

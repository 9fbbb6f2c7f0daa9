"""State of the contract `consent`: choices as steps, and notices."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

from consensus.state.keys import HASH, TEXT, U32, ListRow, Prefix, Reader, Row, StateKey

CONSENT = "consent"
GIVEN = "given"
STEPS_MAX_COUNT = 2
_STEP_TYPES = [int, str, int, int, int, bytes]


class StepRow(ListRow, frozen=True):
    """From `height` on `status` holds; times in ms (0 is no bound), with the mandate's id."""

    height: int
    status: Literal["given", "refused", "withdrawn", "objected"]
    since_ms: int
    from_ms: int
    until_ms: int
    mandate: bytes


class OwnYesRow(ListRow, frozen=True):
    """A person's own consent: from `height` on, in a period (ms; 0 is no bound)."""

    height: int
    from_ms: int
    until_ms: int


class NoticeRow(Row, frozen=True):
    """A version of an organisation's notice."""

    version: int
    hash: bytes
    height: int
    time: int


class NoticeTextRow(NoticeRow, frozen=True):
    """A version with its document."""

    document: bytes


ChoicesRow = dict[str, dict[str, list[StepRow]]]
"""Steps by purpose and sensor."""
OwnRow = dict[str, dict[str, OwnYesRow | None]]
"""A yes or (None) a no, by sensor and purpose; an empty purpose is all that are not named."""

CHOICES: Prefix[ChoicesRow] = Prefix(CONSENT, "of/", (HASH,), ChoicesRow)
"""By handle: steps by purpose and sensor."""
OWN: Prefix[OwnRow] = Prefix(CONSENT, "own/", (HASH,), OwnRow)
"""What a person said last in person, by sensor and purpose; no yes of another's goes beyond it."""
SAID: Prefix[int] = Prefix(CONSENT, "said/", (HASH,), int)
"""The height of a person's last word."""
CHANGES: StateKey[int] = StateKey(CONSENT, "changes", int)
"""How often anything here changed."""
NOTICE: Prefix[NoticeRow] = Prefix(CONSENT, "notice/", (TEXT,), NoticeRow)
"""The version in force, by organisation."""
NOTICE_TEXT: Prefix[NoticeTextRow] = Prefix(CONSENT, "notice-text/", (U32, TEXT), NoticeTextRow)
"""By version and organisation; none goes again."""
LAYOUT = (CHOICES, OWN, SAID, CHANGES, NOTICE, NOTICE_TEXT)


def step_at(steps: list[StepRow], height: int) -> StepRow | None:
    return next((step for step in reversed(steps) if step.height <= height), None)


def allows(state: Reader, handle: bytes, purpose: str, sensor: str, *, height: int, time_ms: int) -> bool:
    steps = (CHOICES.at(state, handle) or {}).get(purpose, {}).get(sensor, [])
    now = step_at(steps, height)
    if now is None or now.status != GIVEN:
        return False
    return now.from_ms <= time_ms and (now.until_ms == 0 or time_ms < now.until_ms)


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

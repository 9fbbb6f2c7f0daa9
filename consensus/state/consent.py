"""State of the contract `consent`: choices as steps, and notices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, Literal

from consensus.state.keys import HASH_BYTES, TEXT, U32_BYTES, ListRow, Prefix, Row, StateKey, try_convert

CONSENT = "consent"
GIVEN: Final = "given"
STEPS_MAX_COUNT = 2


class StepRow(ListRow, frozen=True):
    """From `height` on `status` holds; times in ms (0 is no bound), with the mandate's id (empty: in person).

    `since_ms` is when it was refused, or when unbroken consent began; a recording is allowed before `until_ms`.
    """

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

CHOICES: Prefix[ChoicesRow] = Prefix(CONSENT, "of/", (HASH_BYTES,), ChoicesRow)
"""By handle: steps by purpose and sensor."""
OWN: Prefix[OwnRow] = Prefix(CONSENT, "own/", (HASH_BYTES,), OwnRow)
"""What a person said last in person, by sensor and purpose; no yes of another's goes beyond it."""
LAST_STATEMENT_HEIGHT: Prefix[int] = Prefix(CONSENT, "said/", (HASH_BYTES,), int)
"""The height of a person's last statement."""
CHANGES: StateKey[int] = StateKey(CONSENT, "changes", int)
"""How often anything here changed."""
NOTICE: Prefix[NoticeRow] = Prefix(CONSENT, "notice/", (TEXT,), NoticeRow)
"""The version in force, by organisation."""
NOTICE_TEXT: Prefix[NoticeTextRow] = Prefix(CONSENT, "notice-text/", (U32_BYTES, TEXT), NoticeTextRow)
"""By version and organisation; none goes again."""
LAYOUT = (CHOICES, OWN, LAST_STATEMENT_HEIGHT, CHANGES, NOTICE, NOTICE_TEXT)


Choices = dict[tuple[str, str], tuple[StepRow, ...]]
"""Steps by (purpose, sensor)."""


def read_choices(value: Any) -> Choices:
    """Leave out every choice of an unknown form: it is no consent."""
    return {
        (purpose, sensor): steps
        for purpose, sensors in (value.items() if isinstance(value, dict) else ())
        for sensor, found in (sensors.items() if isinstance(sensors, dict) else ())
        if (steps := try_convert(found, tuple[StepRow, ...]))
    }


def effective_consent(steps: Sequence[StepRow], height: int) -> StepRow | None:
    """Return the consent at a height, or None; refusals count at once, even earlier."""
    held = None
    for step in steps:
        if step.height <= height:
            held = step
        elif step.status != GIVEN:
            return None
    return held if held is not None and held.status == GIVEN else None

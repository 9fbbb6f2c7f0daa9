"""The state layout: all keys of system contracts and the machine."""

from __future__ import annotations

from typing import Any

from consensus.state import (
    access,
    audit,
    consent,
    erasure,
    identity,
    lifecycle,
    mandates,
    membership,
    officers,
    producers,
    records,
    rights,
    settings,
)
from consensus.state.keys import Rows

MODULES = (
    access,
    audit,
    consent,
    erasure,
    identity,
    lifecycle,
    mandates,
    membership,
    officers,
    producers,
    records,
    rights,
    settings,
)
LAYOUT: tuple[Rows[Any], ...] = tuple(rows for module in MODULES for rows in module.LAYOUT)


def owners_of(key: bytes) -> list[Rows[Any]]:
    return [each for each in LAYOUT if each.owns(key)]

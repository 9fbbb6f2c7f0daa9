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

RESERVED_CONTRACTS = frozenset(
    {
        access.ACCESS,
        consent.CONSENT,
        erasure.ERASURE,
        identity.IDENTITY,
        mandates.MANDATES,
        membership.MEMBERSHIP,
        officers.OFFICERS,
        producers.PRODUCERS,
        rights.RIGHTS,
        settings.SETTINGS,
    }
)
"""Contracts by which people control their data, and members the network: a part of every block is for their calls."""
RESERVED_CALLS = frozenset({(records.RECORDS, "transfer"), (records.RECORDS, "withdraw_empty_frames")})
"""Calls of other contracts that have it too: a stolen wallet's visits are moved as soon as what the thief asks for."""


def owners_of(key: bytes) -> list[Rows[Any]]:
    return [each for each in LAYOUT if each.owns(key)]

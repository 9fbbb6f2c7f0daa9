"""What the state says of epochs: the one in force and, of a block, the one it begins.

The contract `producers` writes a single key whenever a change of producers or settings takes effect. A block whose
writes raise the number under it is a boundary.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from consensus.chain.epoch_settings import ChainSettings, Epoch, check_settings
from consensus.chain.schedule import Schedule
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode_value
from consensus.primitives.keys import is_public_key
from consensus.state.producers import EPOCH
from contracts.state.view import StateReader

_MANUAL = "manual"
_SETTINGS = ChainSettings.__struct_fields__


def _epoch_of(value: Any) -> Epoch:
    return Epoch(
        number=value["number"],
        producers=tuple(value["producers"]),
        leaderless=tuple(value["leaderless"]),
        settings=ChainSettings(**value["settings"]),
    )


def is_fit_to_follow(before: bytes, after: bytes | None) -> bool:
    """Tell whether the chain can go on with what a block leaves under `EPOCH`, instead of what stood there before it.

    That is the epoch in force, or the next one: producers with keys that are keys, and settings within their ranges.
    """
    if after is None:
        return False
    current, value = _epoch_of(decode_value(before)), decode_value(after)
    if not _has_form(value):
        return False
    epoch = _epoch_of(value)
    if epoch.number == current.number:
        return epoch == current
    return epoch.number == current.number + 1 and _can_produce(epoch, current)


def _has_form(value: Any) -> bool:
    if not isinstance(value, dict) or type(value.get("number")) is not int:
        return False
    producers, leaderless, settings = (value.get(name) for name in ("producers", "leaderless", "settings"))
    if not isinstance(producers, list) or not isinstance(leaderless, list) or not isinstance(settings, dict):
        return False
    return (
        all(isinstance(key, bytes) for key in producers)
        and all(type(place) is int for place in leaderless)
        and settings.keys() == set(_SETTINGS)
        and all(type(settings[name]) is (str if name == "production" else int) for name in _SETTINGS)
    )


def _can_produce(epoch: Epoch, current: Epoch) -> bool:
    try:
        check_settings(epoch.settings)
        Schedule.of(epoch)
    except BlockRobotError:
        return False
    stands_still = epoch.settings.production == _MANUAL != current.settings.production
    return not stands_still and all(is_public_key(key) for key in epoch.producers)


def read_epoch(state: StateReader) -> Epoch:
    """Return the epoch that follows from this state. Raises GENESIS_INVALID if it names none."""
    data = state.get(EPOCH.flat)
    if data is None:
        raise BlockRobotError("GENESIS_INVALID", "The state names no epoch.")
    return _epoch_of(decode_value(data))


def next_epoch(writes: Mapping[bytes, bytes | None], current: int) -> Epoch | None:
    """Return the epoch that a block with these writes begins, or None if it stays in epoch `current`.

    `writes` are the block's flat keys with encoded values, as in `BlockResult.writes`.
    """
    data = writes.get(EPOCH.flat)
    if data is None:
        return None
    epoch = _epoch_of(decode_value(data))
    return None if epoch.number == current else epoch

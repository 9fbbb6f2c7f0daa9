"""Epochs in the state; writes raising the `producers` epoch number make a boundary."""

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
    """Return whether `EPOCH` holds the same or next epoch, with valid keys and settings."""
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
    """Raises GENESIS_INVALID."""
    data = state.get(EPOCH.flat)
    if data is None:
        raise BlockRobotError("GENESIS_INVALID", "The state names no epoch.")
    return _epoch_of(decode_value(data))


def next_epoch(writes: Mapping[bytes, bytes | None], current: int) -> Epoch | None:
    data = writes.get(EPOCH.flat)
    if data is None:
        return None
    epoch = _epoch_of(decode_value(data))
    return None if epoch.number == current else epoch

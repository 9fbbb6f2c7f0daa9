"""What the state says of epochs: the one in force and, of a block, the one it begins. Must never decide one itself.

The contract `producers` writes a single key whenever a change of producers or settings takes effect. A block whose
writes raise the number under it is a boundary.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode_value
from consensus.settings import ChainSettings, Epoch
from contracts.state.view import StateReader

EPOCH_KEY = b"producers\x00epoch"


def _epoch_of(value: Any) -> Epoch:
    return Epoch(
        number=value["number"],
        producers=tuple(value["producers"]),
        leaderless=tuple(value["leaderless"]),
        settings=ChainSettings(**value["settings"]),
    )


def read_epoch(state: StateReader) -> Epoch:
    """Return the epoch that follows from this state. Raises GENESIS_INVALID if it names none."""
    data = state.get(EPOCH_KEY)
    if data is None:
        raise BlockRobotError("GENESIS_INVALID", "The state names no epoch.")
    return _epoch_of(decode_value(data))


def next_epoch(writes: Mapping[bytes, bytes | None], current: int) -> Epoch | None:
    """Return the epoch that a block with these writes begins, or None if it stays in epoch `current`.

    `writes` are the block's flat keys with encoded values, as in `BlockResult.writes`.
    """
    data = writes.get(EPOCH_KEY)
    if data is None:
        return None
    epoch = _epoch_of(decode_value(data))
    return None if epoch.number == current else epoch

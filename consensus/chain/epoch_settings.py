"""An epoch's producers and chain settings, set by genesis or a boundary block."""

from __future__ import annotations

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import Wire, encode
from consensus.primitives.hashing import tagged_hash

EPOCH_TAG = "blockrobot/schedule"
INTERVAL_MAX_MS = 60_000
"""A transaction lives ten minutes; blocks have to come much more often."""
BASE_TIMEOUT_MIN_MS = 50
TIMEOUT_CAP_MIN_MS = 1_000
TIMEOUT_CAP_MAX_MS = 60_000
HEARTBEAT_MAX_MS = 3_600_000
CLOCK_DRIFT_MIN_MS = 500
CLOCK_DRIFT_MAX_MS = 60_000
BLOCKS_PER_TURN_MAX_COUNT = 100


class ChainSettings(Wire, frozen=True):
    """Chain-wide settings; `production` is `on-demand`, `interval:MS` or `manual`."""

    base_timeout_ms: int = 500
    timeout_cap_ms: int = 8_000
    heartbeat_ms: int = 30_000
    min_block_interval_ms: int = 5
    max_clock_drift_ms: int = 5_000
    blocks_per_turn: int = 1
    production: str = "on-demand"


class Epoch(Wire, frozen=True):
    """What checks an epoch's blocks.

    `producers` are 33-byte keys in turn order; `leaderless` the sorted indexes that vote but never lead.
    """

    number: int
    producers: tuple[bytes, ...]
    leaderless: tuple[int, ...]
    settings: ChainSettings


def compute_epoch_hash(epoch: Epoch) -> bytes:
    return tagged_hash(EPOCH_TAG, encode(epoch))


def parse_production(production: str) -> int | None:
    """Return ms of `interval:MS`, 0 for `on-demand`, None for `manual`. Raises GENESIS_INVALID."""
    if production == "on-demand":
        return 0
    if production == "manual":
        return None
    kind, _, number = production.partition(":")
    if kind == "interval" and number.isascii() and number.isdigit() and len(number) <= 5:
        interval_ms = int(number)
        if 0 < interval_ms <= INTERVAL_MAX_MS:
            return interval_ms
    raise BlockRobotError("GENESIS_INVALID", f"The production setting {production!r} is none.")


def check_settings(settings: ChainSettings) -> None:
    """Check settings to the same ranges as contract `settings`. Raises GENESIS_INVALID."""
    parse_production(settings.production)
    base_ms, cap_ms = settings.base_timeout_ms, settings.timeout_cap_ms
    in_range = (
        BASE_TIMEOUT_MIN_MS <= base_ms <= cap_ms
        and TIMEOUT_CAP_MIN_MS <= cap_ms <= TIMEOUT_CAP_MAX_MS
        and 1 <= settings.heartbeat_ms <= HEARTBEAT_MAX_MS
        and 0 <= settings.min_block_interval_ms < base_ms
        and CLOCK_DRIFT_MIN_MS <= settings.max_clock_drift_ms <= CLOCK_DRIFT_MAX_MS
        and 1 <= settings.blocks_per_turn <= BLOCKS_PER_TURN_MAX_COUNT
    )
    if not in_range:
        raise BlockRobotError("GENESIS_INVALID", "A setting of the chain is out of its range.")

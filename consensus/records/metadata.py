"""Owner-only record metadata; a hash chain within the visit reveals gaps."""

from __future__ import annotations

import re
from collections.abc import Sequence

from consensus.errors import BlockRobotError
from consensus.limits import CLIP_FRAMES_MAX_COUNT
from consensus.primitives.encoding import Wire, encode
from consensus.primitives.hashing import HASH_SIZE_BYTES, tagged_hash

_METADATA_TAG = "blockrobot/metadata"
_CODE = re.compile(r"[A-Za-z0-9_.:+\-]+", re.ASCII)
SENSOR_MAX_CHARS = 64
REASON_MAX_CHARS = 32
REASONS_MAX_COUNT = 8
NO_PREVIOUS = bytes(HASH_SIZE_BYTES)
NOTICE_SENSOR = "notice"
"""The sensor of a record without a picture, which only tells of frames that were withheld."""
MOMENT_MAX_MS = 253_370_764_800_000
"""The first moment of the year 9999: calendars know no later one, so no record is from then."""


class RecordMetadata(Wire, frozen=True):
    """One record's metadata; times are the robot's ms, `withheld` counts frames by reason."""

    sensor: str
    started_at_ms: int
    ended_at_ms: int
    frame_count: int
    index_in_visit: int
    previous_hash: bytes
    withheld: tuple[tuple[str, int], ...]
    width: int
    height: int


def compute_metadata_hash(metadata: RecordMetadata) -> bytes:
    return tagged_hash(_METADATA_TAG, encode(metadata))


def check_metadata(metadata: RecordMetadata) -> None:
    """Check sizes, order and characters (terminal-safe codes). Raises VALUE_INVALID."""
    words = (metadata.sensor, *(reason for reason, _ in metadata.withheld))
    if (
        not 0 < len(metadata.sensor) <= SENSOR_MAX_CHARS
        or not all(_CODE.fullmatch(word) for word in words)
        or not 0 <= metadata.started_at_ms <= metadata.ended_at_ms < MOMENT_MAX_MS
        or not 1 <= metadata.frame_count <= CLIP_FRAMES_MAX_COUNT
        or not 0 <= metadata.index_in_visit < 1 << 32
        or len(metadata.previous_hash) != HASH_SIZE_BYTES
        or len(metadata.withheld) > REASONS_MAX_COUNT
        or any(not 0 < len(reason) <= REASON_MAX_CHARS or count < 0 for reason, count in metadata.withheld)
        or not 0 < metadata.width <= 1 << 16
        or not 0 < metadata.height <= 1 << 16
    ):
        raise BlockRobotError("VALUE_INVALID", "A record's metadata is outside its limits.")


def find_chain_gaps(records: Sequence[RecordMetadata]) -> list[int]:
    """Return missing or unlinked places (from 0); a missing tail needs the closing's count."""
    gaps: set[int] = set()
    expected, previous_hash = 0, NO_PREVIOUS
    for metadata in records:
        place = metadata.index_in_visit
        gaps.update(range(expected, place))
        if place < expected or (place == expected and metadata.previous_hash != previous_hash):
            gaps.add(place)
        expected, previous_hash = max(expected, place + 1), compute_metadata_hash(metadata)
    return sorted(gaps)

"""What a record says to its owner alone: sensor, exact times, place in the visit.

Each record names the hash of the one before in its visit, so that a wallet notices one that is missing or exchanged.
It is sealed, at a fixed size, by `records/envelopes.py`.
"""

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
    """One record's metadata. Times are the robot's clock in ms; `withheld` counts frames kept back, by reason.

    `previous_hash` is `compute_metadata_hash` of the record before in the visit, 32 zero bytes for the first.
    """

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
    """Return the 32-byte hash by which the next record of the visit names this one."""
    return tagged_hash(_METADATA_TAG, encode(metadata))


def check_metadata(metadata: RecordMetadata) -> None:
    """Check sizes, order and letters. Raises VALUE_INVALID. What passes fits into the sealed form, and can be shown.

    The words are codes, in letters that no terminal takes for a command.
    """
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
    """Return the places in a visit (from 0) that are missing or do not follow from the record before.

    `records` are those of one visit in the order of `index_in_visit`. A tail that is missing whole shows only against
    the count in the visit's closing.
    """
    gaps: set[int] = set()
    expected, previous_hash = 0, NO_PREVIOUS
    for metadata in records:
        place = metadata.index_in_visit
        gaps.update(range(expected, place))
        if place < expected or (place == expected and metadata.previous_hash != previous_hash):
            gaps.add(place)
        expected, previous_hash = max(expected, place + 1), compute_metadata_hash(metadata)
    return sorted(gaps)

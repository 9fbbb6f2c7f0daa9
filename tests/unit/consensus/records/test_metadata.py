"""Record metadata: bounded, chained, so that a wallet notices what is missing."""

from __future__ import annotations

import msgspec
import pytest

from consensus.errors import BlockRobotError
from consensus.limits import SEALED_METADATA_BYTES
from consensus.primitives.encoding import decode, encode
from consensus.records.metadata import (
    MOMENT_MAX_MS,
    NO_PREVIOUS,
    REASON_MAX_CHARS,
    REASONS_MAX_COUNT,
    SENSOR_MAX_CHARS,
    RecordMetadata,
    check_metadata,
    compute_metadata_hash,
    find_chain_gaps,
)
from consensus.rights.purposes import PURPOSE_MAX_CHARS, PURPOSES, require_purpose


def _chain(count: int) -> list[RecordMetadata]:
    records: list[RecordMetadata] = []
    previous_hash = NO_PREVIOUS
    for index in range(count):
        record = RecordMetadata(
            sensor="depth",
            started_at_ms=1000 * index,
            ended_at_ms=1000 * index + 500,
            frame_count=15,
            index_in_visit=index,
            previous_hash=previous_hash,
            withheld=(("ambiguous", 2),),
            width=640,
            height=480,
        )
        records.append(record)
        previous_hash = compute_metadata_hash(record)
    return records


def test_metadata_survives_its_encoding() -> None:
    record = _chain(1)[0]
    assert decode(encode(record), RecordMetadata) == record


def test_a_chain_names_the_record_that_is_missing_exchanged_or_repeated() -> None:
    assert find_chain_gaps(_chain(6)) == []
    assert find_chain_gaps([]) == []
    records = _chain(6)
    assert find_chain_gaps(records[:2] + records[4:]) == [2, 3]
    assert find_chain_gaps(records[1:]) == [0]
    records = _chain(4)
    forged = msgspec.structs.replace(records[2], sensor="other")
    assert find_chain_gaps([*records[:2], forged, records[3]]) == [3]
    assert find_chain_gaps([*records[:3], records[2], records[3]]) == [2]


def test_the_largest_metadata_fits_into_its_sealed_form() -> None:
    largest = RecordMetadata(
        sensor="s" * SENSOR_MAX_CHARS,
        started_at_ms=MOMENT_MAX_MS - 1,
        ended_at_ms=MOMENT_MAX_MS - 1,
        frame_count=64,
        index_in_visit=(1 << 32) - 1,
        previous_hash=bytes(32),
        withheld=tuple(("r" * REASON_MAX_CHARS, (1 << 32) - 1) for _ in range(REASONS_MAX_COUNT)),
        width=1 << 16,
        height=1 << 16,
    )
    check_metadata(largest)
    assert len(encode(largest)) <= SEALED_METADATA_BYTES - 48 - 4


@pytest.mark.parametrize(
    "change",
    [
        {"sensor": ""},
        {"sensor": "s" * 65},
        {"frame_count": 0},
        {"frame_count": 65},
        {"ended_at_ms": -1},
        {"previous_hash": b""},
        {"withheld": (("", 1),)},
        {"withheld": (("x", -1),)},
        {"width": 0},
        {"sensor": "depth\x1b[2J"},
        {"sensor": "[red]depth"},
        {"sensor": "depth\x9b2J"},
        {"withheld": (("moved\x1b]0;x\x07", 1),)},
        {"started_at_ms": MOMENT_MAX_MS, "ended_at_ms": MOMENT_MAX_MS},
        {"ended_at_ms": (1 << 53) - 1},
    ],
)
def test_metadata_outside_the_limits_is_refused(change: dict[str, object]) -> None:
    with pytest.raises(BlockRobotError, match="VALUE_INVALID"):
        check_metadata(msgspec.structs.replace(_chain(1)[0], **change))


def test_purposes_are_codes_with_sentences() -> None:
    for code, sentence in PURPOSES.items():
        assert require_purpose(code) == sentence
        assert code.isascii()
        assert len(code) <= PURPOSE_MAX_CHARS
    with pytest.raises(BlockRobotError, match="PURPOSE_UNKNOWN"):
        require_purpose("because")

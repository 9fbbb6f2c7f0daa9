"""What the final state says of a robot that uploads: its organisation, its open visits. Must never take its own word."""

from __future__ import annotations

from typing import Any

from consensus.primitives.encoding import decode_value
from contracts.execution.standing import Reader


def _read(state: Reader, key: bytes) -> Any:
    value = state.get(key)
    return None if value is None else decode_value(value)


def find_organisation(state: Reader, robot: bytes) -> str:
    """Return the name of a member's organisation, or an empty text for a key of no member."""
    entry = _read(state, b"identity\x00member/" + robot)
    return "" if entry is None else str(entry["org"])


def find_visit(state: Reader, owner: bytes) -> Any:
    """Return the visit under an owner key, or None."""
    return _read(state, b"records\x00visit/" + owner)


def may_upload(state: Reader, record_id: bytes, owner: bytes, robot: bytes) -> bool:
    """Tell whether a clip is of a visit that this robot has open, or of a record that it made already."""
    visit = find_visit(state, owner)
    if visit is not None and visit["robot"] == robot and visit["status"] == "open":
        return True
    record = _read(state, b"records\x00record/" + record_id)
    return record is not None and bool(record["robot"] == robot)


def is_frame_approved_for_any(state: Reader, digest: bytes) -> bool:
    """Tell whether an empty frame is approved for any robot."""
    return state.get(b"records\x00empty-frame/" + digest) is not None


def is_frame_approved(state: Reader, robot: bytes, digest: bytes) -> bool:
    """Tell whether an empty frame is approved for this robot."""
    rows = _read(state, b"records\x00empty-frames/" + robot) or []
    return any(row[0] == digest for row in rows)

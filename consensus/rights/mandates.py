"""Codes and bounds of mandates (same as contract `mandates`); health-revealing reasons are only committed to."""

from __future__ import annotations

from collections.abc import Sequence

from consensus.primitives.hashing import tagged_hash

PAPERS_TAG = "blockrobot/mandate-papers"
SALT_BYTES = 32
REASON_FIELD_BYTES = 32
"""Every reason is hashed at this length."""
PAPERS_MAX_COUNT = 32
ACTS = ("consent",)
APPROVE_MS = 3 * 24 * 3600 * 1000
"""How long a proposal waits for a second officer."""
ACCEPT_MS = 7 * 24 * 3600 * 1000
"""How long an approved mandate waits for the representative."""
LASTS_MAX_MS = 366 * 24 * 3600 * 1000

MANDATE_REASONS: dict[str, str] = {
    "minor": "The person is a child, and this is a parent or guardian.",
    "incapacity": "The person cannot decide any more, by a doctor's or court's finding.",
    "court-order": "A court named this representative.",
}


def commit_papers(salt: bytes, reason: str, digests: Sequence[bytes]) -> bytes:
    """Return the 32-byte commitment to reason and paper SHA-256 hashes, in any order."""
    return tagged_hash(PAPERS_TAG, salt, reason.encode().ljust(REASON_FIELD_BYTES, b"\x00"), *sorted(digests))

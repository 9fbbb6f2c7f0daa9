"""The codes and bounds of mandates, and the commitment to a guardian's papers.

The reason is a code from a list, and is committed to with the papers: on the chain it would be a word about somebody's
health, for ever. The contract `mandates` knows the same bounds.
"""

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
    """Return the 32-byte commitment to a reason and the SHA-256 of each paper, in whatever order they were named."""
    return tagged_hash(PAPERS_TAG, salt, reason.encode().ljust(REASON_FIELD_BYTES, b"\x00"), *sorted(digests))

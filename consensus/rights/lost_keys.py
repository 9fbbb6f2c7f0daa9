"""Codes and bounds for lost-key erasure by two officers; same as contract `officers`."""

from __future__ import annotations

SPAN_MAX_MS = 3600 * 1000
"""How long a span may be: others whom the robot met in it lose their visits too."""
VISITS_MAX_COUNT = 64
APPROVE_MS = 3 * 24 * 3600 * 1000
"""How long a proposal waits for a second officer."""
CARRY_OUT_MS = 7 * 24 * 3600 * 1000
"""How long an approved proposal may be carried out: a robot's spool may deliver records a day late."""

LOST_KEY_REASONS: dict[str, str] = {
    "key-lost": "The person's key is lost for good, and they ask for it (Art. 17(1)).",
    "owner-died": "The person died, and those who speak for them ask for it.",
    "guardian-request": "The person's guardian asks for it.",
    "authority-order": "An authority or a court ordered it (Art. 17(1)(e), Art. 58(2)(g)).",
}

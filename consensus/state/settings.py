"""State of the contract `settings`: decided upload quotas; the rest is in `producers`."""

from __future__ import annotations

from consensus.state.keys import TEXT, Prefix

SETTINGS = "settings"

QUOTA: Prefix[int] = Prefix(SETTINGS, "quota/", (TEXT,), int)
"""By the name of a setting; while nobody decided it its default holds."""
LAYOUT = (QUOTA,)

"""Says how many there are of something, as people say it: `1 record`, `2 records`."""

from __future__ import annotations


def counted(count: int, one: str, many: str = "") -> str:
    """Return a count with the word for one thing, or for several (`many`; by default `one` with an s)."""
    return f"{count} {one if count == 1 else many or one + 's'}"

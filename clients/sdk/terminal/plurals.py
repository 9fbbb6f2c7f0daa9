"""Counts with singular or plural nouns."""

from __future__ import annotations


def pluralize(count: int, one: str, many: str = "") -> str:
    """Return count and noun, e.g. `2 records`."""
    return f"{count} {one if count == 1 else many or one + 's'}"

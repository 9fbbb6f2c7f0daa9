"""What a wallet remembers of guardians, in its encrypted file alone. Must never hold a share, nor a word of one.

It names people, so it leaves that file for nobody but its owner.
"""

from __future__ import annotations

from typing import Any

import msgspec

NAME_MAX_CHARS = 40


class GuardianSet(msgspec.Struct):
    """Shares that were made at one time: when, how many are needed, for whom, and the number that all of them bear.

    `era` says of which of the wallet's words they are, counted from its first. `handed_count` of the guardians had
    theirs when it ended.
    """

    made_at_ms: int
    threshold: int
    guardians: list[str]
    identifier: int
    era: int
    handed_count: int = 0

    @property
    def is_whole(self) -> bool:
        """Tell whether every guardian was given a share."""
        return self.handed_count == len(self.guardians)


def set_json(one: GuardianSet, present_era: int) -> dict[str, Any]:
    """Return a set for a program. No share is in it: the wallet has none."""
    return {
        "identifier": one.identifier,
        "made_at_ms": one.made_at_ms,
        "threshold": one.threshold,
        "guardians": one.guardians,
        "handed_over": one.handed_count,
        "words_in_force": one.era == present_era,
    }


def wrong_names(names: tuple[str, ...]) -> str:
    """Say what is wrong with guardians' names, in a sentence; nothing if they are good."""
    for name in names:
        if not name.strip() or len(name) > NAME_MAX_CHARS or not name.isprintable():
            return f"A guardian's name has 1 to {NAME_MAX_CHARS} characters that can be printed."
    folded = [" ".join(name.split()).casefold() for name in names]
    double = next((name for place, name in enumerate(names) if folded[place] in folded[:place]), None)
    return "" if double is None else f"Two guardians are called {double}: tell them apart."

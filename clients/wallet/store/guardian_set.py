"""What a wallet remembers of guardians, in its encrypted file alone.

It names people, so it leaves that file for nobody but its owner.
"""

from __future__ import annotations

from typing import Any

import msgspec

from clients.wallet.present.translations import WrongUsage

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


def require_names(names: tuple[str, ...]) -> None:
    """Raise WrongUsage for guardians' names that cannot be printed, or tell two of them apart by nothing."""
    for name in names:
        if not name.strip() or len(name) > NAME_MAX_CHARS or not name.isprintable():
            raise WrongUsage("guardian_name", count=NAME_MAX_CHARS)
    folded = [" ".join(name.split()).casefold() for name in names]
    double = next((name for place, name in enumerate(names) if folded[place] in folded[:place]), None)
    if double is not None:
        raise WrongUsage("guardian_double", name=double)

"""A wallet's memory of guardians, stored only in its encrypted file."""

from __future__ import annotations

import msgspec

from clients.wallet.presentation.translations import WrongUsage

NAME_MAX_CHARS = 40


class GuardianSet(msgspec.Struct):
    """One set of guardian shares, with the identifier that all bear.

    `era` numbers the wallet's mnemonics from its first; `handed_count` guardians had received theirs at the end.
    """

    made_at_ms: int
    threshold: int
    guardians: list[str]
    identifier: int
    era: int
    handed_count: int = 0

    @property
    def is_whole(self) -> bool:
        return self.handed_count == len(self.guardians)


def require_names(names: tuple[str, ...]) -> None:
    """Raise WrongUsage for unprintable or indistinguishable guardian names."""
    for name in names:
        if not name.strip() or len(name) > NAME_MAX_CHARS or not name.isprintable():
            raise WrongUsage("guardian_name", count=NAME_MAX_CHARS)
    folded = [" ".join(name.split()).casefold() for name in names]
    double = next((name for place, name in enumerate(names) if folded[place] in folded[:place]), None)
    if double is not None:
        raise WrongUsage("guardian_double", name=double)

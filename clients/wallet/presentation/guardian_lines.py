"""Text about guardians for the terminal and the wallet's page."""

from __future__ import annotations

import functools
from typing import NamedTuple

from clients.wallet.presentation.translations import text
from clients.wallet.recovery.slip39_shares import show_identifier
from clients.wallet.store.keystore import GuardianSet, WalletContent


class GuardianLine(NamedTuple):
    """A sentence and the moment shown before it (None: none)."""

    sentence: str
    at_ms: int | None = None


def guardian_lines(content: WalletContent, language: str | None = None) -> list[GuardianLine]:
    say = functools.partial(text, language=language)
    era, lines = len(content.former), []
    if not any(one.era == era for one in content.guardian_sets):
        lines += [GuardianLine(line) for line in say("guardians.none").split("\n")]
    for one in content.guardian_sets:
        lines.append(_line(one, language))
        if not one.is_whole:
            count = len(one.guardians)
            lines.append(GuardianLine(say("guardians.cut_short", handed=one.handed_count, count=count)))
        if one.era != era:
            lines.append(GuardianLine(say("guardians.former")))
    if content.guardian_sets:
        lines.append(GuardianLine(say("guardians.stay")))
    return lines


def _line(one: GuardianSet, language: str | None) -> GuardianLine:
    values: dict[str, object] = {"identifier": show_identifier(one.identifier), "threshold": one.threshold}
    if not one.guardians:
        return GuardianLine(text("guardians.line_unknown", language=language, **values))
    values |= {"count": len(one.guardians), "names": ", ".join(one.guardians)}
    return GuardianLine(text("guardians.line", language=language, **values), one.made_at_ms)

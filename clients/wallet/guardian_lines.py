"""What is told of guardians, at a terminal and on the wallet's page. Must never tell a word of a share: it knows none."""

from __future__ import annotations

from typing import Any

from clients.wallet.guardians import GuardianSet
from clients.wallet.keystore import WalletContent
from clients.wallet.language import text
from clients.wallet.shares import show_identifier
from pages.moments import show_moment


def guardian_lines(content: WalletContent, language: str | None = None) -> list[str]:
    """Return who holds words of this wallet and what to do next, in sentences (`language` None: the one in use)."""
    era, told = len(content.former), []
    if not any(one.era == era for one in content.guardian_sets):
        told += text("guardians.none", language=language).split("\n")
    for one in content.guardian_sets:
        told.append(_line(one, language))
        if not one.is_whole:
            count = len(one.guardians)
            told.append(text("guardians.cut_short", language=language, handed=one.handed_count, count=count))
        if one.era != era:
            told.append(text("guardians.former", language=language))
    if content.guardian_sets:
        told.append(text("guardians.stay", language=language))
    return told


def _line(one: GuardianSet, language: str | None) -> str:
    values: dict[str, Any] = {"identifier": show_identifier(one.identifier), "threshold": one.threshold}
    if not one.guardians:
        return text("guardians.line_unknown", language=language, **values)
    values |= {"count": len(one.guardians), "names": ", ".join(one.guardians), "moment": show_moment(one.made_at_ms)}
    return text("guardians.line", language=language, **values)

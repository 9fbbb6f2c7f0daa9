"""What a former recovery phrase or a lost membership left out of reach, in words and as answers."""

from __future__ import annotations

from clients.wallet.answers.record_answers import FormerVisits
from clients.wallet.ledger.wallet import VisitReport, Wallet
from clients.wallet.presentation.translations import text
from clients.wallet.store.keystore import KnownVisit, WalletContent

STOLEN_PAGE = "docs/how-to/when-your-wallet-is-stolen.md"


def taken_lines(count: int, language: str | None = None) -> list[str]:
    return [text("former.taken", language=language, count=count, page=STOLEN_PAGE)] if count else []


def stuck_lines(count: int, language: str | None = None) -> list[str]:
    return [text("former.stuck", language=language, count=count, page=STOLEN_PAGE)] if count else []


def unreadable_words(report: VisitReport) -> str:
    return text("former.needed" if report.needs_former_words else "former.unreadable", count=len(report.unreadable_ids))


def former_visits(content: WalletContent) -> FormerVisits:
    """Not controlled by the present mnemonic."""
    return FormerVisits(
        taken_visits=[visit.owner.hex() for visit in content.visits if visit.taken],
        exposed_visits=[visit.owner.hex() for visit in exposed(content)],
        stuck_visits=[visit.owner.hex() for visit in content.visits if visit.stuck and not visit.taken],
    )


def exposed(content: WalletContent) -> list[KnownVisit]:
    """Former mnemonics control them, and they can be replaced."""
    present = len(content.former)
    return [visit for visit in content.visits if visit.era != present and not visit.taken and not visit.stuck]


def words_lines(content: WalletContent, language: str | None = None) -> list[str]:
    """On visits not controlled by the present mnemonic."""
    count = len(exposed(content))
    lines = [text("former.exposed", language=language, count=count)] if count else []
    lines += taken_lines(sum(visit.taken for visit in content.visits), language)
    return lines + stuck_lines(sum(visit.stuck and not visit.taken for visit in content.visits), language)


def member_gone_line(opened: Wallet, language: str | None = None) -> list[str]:
    """If membership is lost (`language` None: current)."""
    if not opened.member_gone:
        return []
    lines, lost = [text("former.gone", language=language)], len(opened.out_of_reach)
    if lost:
        lines.append(text("former.lost", language=language, count=lost))
    next_key = "former.finish" if opened.store.content.next_words else "former.to_desk"
    return [" ".join([*lines, text(next_key, language=language, page=STOLEN_PAGE)])]

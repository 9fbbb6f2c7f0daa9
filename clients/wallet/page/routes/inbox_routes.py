"""Routes for accesses, alarms and received shares."""

from __future__ import annotations

from aiohttp import web

from clients.sdk.terminal.json_answers import Answer, Hex, extend
from clients.wallet.answers.sharing_answers import ReceivedShare, UnreadShare, VisitAlarm
from clients.wallet.page.page_answers import answer_json, language_of, route
from clients.wallet.page.routes.reading_routes import page_erasure
from clients.wallet.page.session import PageSession
from clients.wallet.page.wallet_snapshot import VisitPart
from clients.wallet.presentation.erasure_text import custodian_names
from clients.wallet.presentation.share_text import (
    incoming_share_lines,
    name_recipient,
    received_share,
    unread_line,
    unread_share,
    visit_alarm,
)
from clients.wallet.sharing.inbox import read_inbox
from clients.wallet.text_catalogue import DEFAULT_LANGUAGE
from pages.local_page import LocalRoute


class PageLook(Answer, frozen=True, kw_only=True):
    """One time that a grantee looked at shared records."""

    time_ms: int
    who: str
    records: int
    visit: Hex
    grant_id: Hex
    sentence: str


class PageReceivedShare(ReceivedShare, frozen=True, kw_only=True):
    """A grant that one received."""

    lines: list[str]


class PageUnreadShare(UnreadShare, frozen=True, kw_only=True):
    """A grant that could not be read."""

    line: str


class PageVisitAlarm(VisitAlarm, frozen=True, kw_only=True):
    """What is wrong with a visit."""

    corrupted_records: list[Hex]
    sentence: str


def routes(session: PageSession) -> list[LocalRoute]:
    return [route(session, "GET", "/api/inbox", _inbox)]


async def _inbox(session: PageSession, request: web.Request) -> web.Response:
    language = language_of(request)
    async with session.hold() as wallet:
        found = await read_inbox(wallet)
    snapshot = session.snapshot
    looks = [
        PageLook(
            time_ms=look.time_ms,
            who=name_recipient(share, language),
            records=look.records_count,
            visit=share.visit.owner.hex(),
            grant_id=share.grant.grant_id.hex(),
            sentence=f"{name_recipient(share, DEFAULT_LANGUAGE)} asked for {look.records_count} records that you share.",
        )
        for share in snapshot.shares()
        for look in share.looks
    ]
    alarms = [_alarm(part) for part in snapshot.visits if part.is_alarming]
    erasures, names = snapshot.erasures(session.now_ms()), custodian_names(session.wallet)
    return answer_json(
        {
            "reads_new": found.reads_new,
            "looks": sorted(looks, key=lambda look: look.time_ms, reverse=True),
            "alarms": alarms,
            "received": [
                extend(PageReceivedShare, received_share(each), lines=incoming_share_lines(each, language))
                for each in found.shares
            ],
            "unread": [
                extend(PageUnreadShare, unread_share(each), line=unread_line(each, language)) for each in found.unread
            ],
            "overdue": [
                page_erasure(each, names) for each in erasures if any(word.overdue for word in each.custodians)
            ],
        }
    )


def _alarm(part: VisitPart) -> PageVisitAlarm:
    report, corrupted = part.report, [record_id.hex() for record_id in part.corrupted_ids]
    answers = []
    if report.missing_count:
        answers.append(f"{report.missing_count} records are missing. Ask the hospital why.")
    if report.unreadable_ids:
        answers.append(f"{len(report.unreadable_ids)} records do not open with your keys. Ask the hospital why.")
    if corrupted:
        answers.append(f"{len(corrupted)} records are not as the robot took them, as you found. Ask the hospital why.")
    return extend(PageVisitAlarm, visit_alarm(report), corrupted_records=corrupted, sentence=" ".join(answers))

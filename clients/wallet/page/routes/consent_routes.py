"""Routes for consent: read, give, refuse, withdraw."""

from __future__ import annotations

import msgspec
from aiohttp import web

from clients.sdk.terminal.json_answers import extend
from clients.wallet.answers.consent_answers import ConsentChoice, NoticeAnswer
from clients.wallet.consent.consent_choices import ConsentClient, ConsentDecision, round_period
from clients.wallet.consent.notice_reading import Notices, NoticeView
from clients.wallet.consent.receipt_fetching import ConsentReceipts, try_fetch_receipt
from clients.wallet.page.jobs import Job, Result
from clients.wallet.page.page_answers import accepted, answer_json, body_of, language_of, route
from clients.wallet.page.session import PageSession
from clients.wallet.presentation.consent_text import (
    choice_answer,
    fetched_receipt,
    notice_answer,
    notice_words,
    receipt_line,
)
from clients.wallet.text_catalogue import refusal
from consensus.errors import BlockRobotError
from consensus.rights.purposes import PURPOSES
from consensus.rights.right_codes import OWN_PURPOSES
from consensus.rights.sensors import SENSORS
from consensus.state.consent import GIVEN
from pages.local_page import LocalRoute


def routes(session: PageSession) -> list[LocalRoute]:
    return [
        route(session, "GET", "/api/consents", _consents),
        route(session, "POST", "/api/consents/give", _give),
        route(session, "POST", "/api/consents/refuse", _refuse),
        route(session, "POST", "/api/consents/withdraw", _withdraw),
        route(session, "GET", "/api/consents/receipts", _receipts),
        route(session, "GET", "/api/notice", _notice),
        route(session, "POST", "/api/notice/shown", _shown),
    ]


class PageNotice(NoticeAnswer, frozen=True, kw_only=True):
    """A notice."""

    must_show: bool


class PageChoice(ConsentChoice, frozen=True, kw_only=True):
    """The last word on a purpose and a sensor."""

    lacks_depth: bool


def _page_notice(notices: Notices, notice_view: NoticeView, request: web.Request) -> PageNotice:
    answer = extend(PageNotice, notice_answer(notice_view), must_show=notices.is_new(notice_view))
    return msgspec.structs.replace(answer, lines=notice_words(notice_view, language_of(request)))


async def _consents(session: PageSession, request: web.Request) -> web.Response:
    async with session.hold() as wallet:
        notices = Notices(wallet)
        found, notice_view = await ConsentClient(wallet).choices(), await notices.current()
    known = [code for code in wallet.genesis.purposes if code not in OWN_PURPOSES]
    askable = notice_view.askable(known)
    grounds = {code: ground for code, ground in notice_view.other_grounds().items() if code in known}
    spoken = {row.purpose for row in found.rows}
    lacking = found.lacking_depth
    shown = [code for code in known if code in askable or code in grounds or code in spoken]
    return answer_json(
        {
            "height": found.height,
            "choices": [extend(PageChoice, choice_answer(row), lacks_depth=row in lacking) for row in found.rows],
            "purposes": {code: PURPOSES.get(code, code) for code in shown},
            "askable": askable,
            "grounds": grounds,
            "sensors": SENSORS,
            "notice": _page_notice(notices, notice_view, request),
        }
    )


async def _notice(session: PageSession, request: web.Request) -> web.Response:
    async with session.hold() as wallet:
        notices = Notices(wallet)
        return answer_json(_page_notice(notices, await notices.current(), request))


async def _shown(session: PageSession, request: web.Request) -> web.Response:
    asked = await body_of(request)
    version = asked.number("version")
    asked.end()
    async with session.hold() as wallet:
        notices = Notices(wallet)
        notice_view = await notices.current()
        if notice_view.version == version:
            notices.note_shown(notice_view)
    session.look_again()
    return answer_json(_page_notice(notices, notice_view, request))


async def _give(session: PageSession, request: web.Request) -> web.Response:
    asked = await body_of(request)
    purposes, sensors = asked.texts("purposes"), asked.texts("sensors")
    from_ms, until_ms = asked.number("from_ms", 0), asked.number("until_ms", 0)
    period = round_period(from_ms, until_ms)
    version = asked.number("notice_version")
    asked.end()
    if not purposes or not sensors:
        raise refusal("REQUEST_INVALID", "consent_choose")
    if until_ms and period[1] <= max(period[0], session.now_ms()):
        raise refusal("REQUEST_INVALID", "consent_over")

    async def work(job: Job) -> Result:
        wallet = session.wallet
        notices = Notices(wallet)
        job.tell("reading what you are told")
        notice_view = await notices.current()
        if notice_view.version != version:
            raise BlockRobotError("NOTICE_NOT_SHOWN")
        notice_view.require_named(purposes, sensors)
        notices.note_shown(notice_view)
        job.tell("writing it into the ledger")
        word = await ConsentClient(wallet).give(
            purposes, sensors, from_ms=period[0], until_ms=period[1], seen_height=notice_view.height
        )
        answer = await _said(session, job, word, GIVEN)
        notices.note_consented(notice_view)
        return answer

    return accepted(session.jobs.start("consent", work))


async def _refuse(session: PageSession, request: web.Request) -> web.Response:
    asked = await body_of(request)
    purposes, sensors = asked.texts("purposes"), asked.texts("sensors")
    asked.end()
    if not purposes:
        raise refusal("REQUEST_INVALID", "consent_refuse")

    async def work(job: Job) -> Result:
        job.tell("writing it into the ledger")
        return await _said(session, job, await ConsentClient(session.wallet).refuse(purposes, sensors), "refused")

    return accepted(session.jobs.start("consent", work))


async def _withdraw(session: PageSession, request: web.Request) -> web.Response:
    asked = await body_of(request)
    purposes, sensors = asked.texts("purposes"), asked.texts("sensors")
    asked.end()

    async def work(job: Job) -> Result:
        job.tell("writing it into the ledger")
        return await _said(session, job, await ConsentClient(session.wallet).withdraw(purposes, sensors), "withdrawn")

    return accepted(session.jobs.start("consent", work))


async def _said(session: PageSession, job: Job, word: ConsentDecision, status: str) -> Result:
    job.tell("fetching the receipt")
    receipted = await try_fetch_receipt(session.wallet, word.txid)
    return {
        "txid": word.txid.hex(),
        "height": word.height,
        "from_height": word.from_height,
        "count": word.count,
        "status": status,
        "sentence": f"It holds from block {word.from_height} on.",
        "receipt": fetched_receipt(receipted),
        "receipt_error": receipted.error_code,
        "receipt_sentence": receipt_line(receipted),
    }


async def _receipts(session: PageSession, _request: web.Request) -> web.Response:
    async with session.hold() as wallet:
        found = await ConsentReceipts(wallet).all()
    rows = [
        {
            "time_ms": receipt.statement.time_ms,
            "height": receipt.statement.height,
            "status": receipt.statement.status,
            "purposes": list(receipt.statement.purposes),
            "sensors": list(receipt.statement.sensors),
            "signed_by": receipt.node,
            "organisation": receipt.organisation,
            "notice_version": None if receipt.published is None else receipt.published.row.version,
            "sentence": f"Block {receipt.statement.height}, signed by {receipt.node} of {receipt.organisation} and by you.",
        }
        for receipt in found.checked
    ]
    return answer_json({"receipts": rows, "missing": len(found.missing)})

"""Routes for registration by card code; it gives no consent."""

from __future__ import annotations

import asyncio
import base64
import binascii

import msgspec
from aiohttp import web

from clients.sdk.terminal.qr_codes import read_qr
from clients.wallet.consent.notice_reading import Notices, NoticeView
from clients.wallet.page.jobs import Job, Result
from clients.wallet.page.page_answers import accepted, answer_json, body_of, language_of, route
from clients.wallet.page.session import PageSession
from clients.wallet.presentation.consent_text import notice_answer, notice_words
from consensus.errors import BlockRobotError
from consensus.members.vouchers import decode_card_code
from pages.local_page import LocalRoute

CODE_MAX_CHARS = 1_024
PICTURE_MAX_CHARS = 1_000_000
"""The page sends it smaller than a camera takes it, so that it fits into a request."""
NAME_MAX_CHARS = 256
HASH_MAX_CHARS = 64


def routes(session: PageSession) -> list[LocalRoute]:
    return [
        route(session, "POST", "/api/registration/plan", _plan),
        route(session, "POST", "/api/registration/picture", _picture),
        route(session, "POST", "/api/registration", _register),
    ]


async def _picture(_session: PageSession, request: web.Request) -> web.Response:
    asked = await body_of(request)
    picture = asked.text("picture", max_chars=PICTURE_MAX_CHARS)
    asked.end()
    try:
        data = base64.b64decode(picture, validate=True)
    except (binascii.Error, ValueError):
        raise BlockRobotError("QR_UNREADABLE", "The picture is not written in base64.") from None
    code = await asyncio.to_thread(read_qr, data)
    decode_card_code(code)
    return answer_json({"code": code})


async def _plan(session: PageSession, request: web.Request) -> web.Response:
    asked = await body_of(request)
    code = asked.text("code", max_chars=CODE_MAX_CHARS).strip()
    asked.end()
    role = decode_card_code(code).role
    async with session.hold() as wallet:
        notice_view = await Notices(wallet).for_card(code)
    notice = msgspec.structs.replace(notice_answer(notice_view), lines=notice_words(notice_view, language_of(request)))
    return answer_json({"role": role, "notice": notice})


def _what_is(notice_view: NoticeView) -> tuple[str, int, str]:
    """Organisation, version and hash (empty if unpublished)."""
    return (
        notice_view.organisation,
        notice_view.version,
        "" if notice_view.published is None else notice_view.published.row.digest.hex(),
    )


async def _register(session: PageSession, request: web.Request) -> web.Response:
    asked = await body_of(request)
    passphrase, code = asked.text("passphrase"), asked.text("code", max_chars=CODE_MAX_CHARS).strip()
    shown = (
        asked.text("organisation", max_chars=NAME_MAX_CHARS),
        asked.number("notice_version"),
        asked.text("notice_hash", max_chars=HASH_MAX_CHARS),
    )
    asked.end()
    decode_card_code(code)
    await session.gate.require(passphrase)

    async def work(job: Job) -> Result:
        notices = Notices(session.wallet)
        job.tell("reading what you are told")
        notice_view = await notices.for_card(code)
        # Versions count per organisation: another card has another notice under the same number.
        if shown != _what_is(notice_view):
            raise BlockRobotError("NOTICE_NOT_SHOWN")
        job.tell("writing it into the ledger")
        done = await session.wallet.register(code, [])
        notices.note_shown(notice_view)
        return {"txid": done.txid.hex(), "member": done.member.hex(), "organisation": notice_view.organisation}

    return accepted(session.jobs.start("register", work))

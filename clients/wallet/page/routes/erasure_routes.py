"""Routes for erasure: preview, confirmation, receipts."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping

from aiohttp import web

from clients.sdk.terminal.json_answers import Hex, extend
from clients.wallet.answers.record_answers import CustodianAnswer
from clients.wallet.ledger.record_filter import Filter
from clients.wallet.ledger.wallet import RecordEntry
from clients.wallet.page.jobs import Job, Result
from clients.wallet.page.page_answers import accepted, answer_json, body_of, language_of, route
from clients.wallet.page.record_days import kind_of, kinds_json, read_zone, select
from clients.wallet.page.request_fields import RequestFields
from clients.wallet.page.routes.reading_routes import page_erasure, page_share
from clients.wallet.page.session import PageSession
from clients.wallet.presentation.erasure_text import custodian_names, erasure_row
from clients.wallet.records.erasure import ErasureClient, missing_pictures, split_erased
from clients.wallet.records.erasure_status import ErasureProgress, find_erasures_of
from clients.wallet.records.viewing import name_places
from clients.wallet.refusals import refusal
from clients.wallet.sharing.outgoing_shares import SharingClient
from clients.wallet.store.keystore import KnownVisit
from pages.local_page import LocalRoute

WAIT_MAX_S = 60.0
_POLL_S = 0.5


def routes(session: PageSession) -> list[LocalRoute]:
    return [
        route(session, "POST", "/api/erasures/plan", _plan),
        route(session, "POST", "/api/erasures", _erase),
    ]


def _named(session: PageSession, ids: list[bytes], frames: list[int]) -> tuple[list[RecordEntry], list[int]]:
    """Not yet being erased. Raises NOT_FOUND, REQUEST_INVALID."""
    entries = [session.snapshot.entry(record_id) for record_id in ids]
    active = [entry for entry in entries if entry.state.status == "active"]
    left = frames
    if frames:
        if len(entries) != 1:
            raise refusal("REQUEST_INVALID", "erase_frames")
        (entry,) = entries
        committed = session.clips.count_committed(entry.record_id)
        count = entry.metadata.frame_count if committed is None else committed
        missing = missing_pictures(frames, count)
        if missing:
            raise refusal("REQUEST_INVALID", "erase_pictures", missing=name_places(missing), count=count)
        left, _ = split_erased(entry, frames, session.snapshot.part_of(entry.visit.owner).trail)
    if not active or (frames and not left):
        raise refusal("NOT_FOUND", "erase_nothing")
    return active, left


def _wanted(session: PageSession, asked: RequestFields) -> list[bytes]:
    everything, day = asked.flag("all", default=False), asked.text("day", "", max_chars=10)
    zone, ids = asked.text("zone", ""), asked.ids("records")
    if everything or day:
        found = select(session.snapshot, Filter((day, day) if day else None, zone=read_zone(zone)))
        return [entry.record_id for part, entry in found if not part.report.rights.breach_id]
    return ids


async def _plan(session: PageSession, request: web.Request) -> web.Response:
    asked = await body_of(request)
    ids, frames = _wanted(session, asked), asked.numbers("frames")
    asked.end()
    entries, frames = _named(session, ids, frames)
    known = {entry.record_id for entry in entries}
    recipients = [share for share in session.snapshot.shares() if known.intersection(share.grant.row.records)]
    kinds = {kind_of(entries[0]): len(frames)} if frames else kinds_json(entries)
    visits = len({entry.visit.owner for entry in entries})
    now_ms, language = session.now_ms(), language_of(request)
    return answer_json(
        {
            "records": [entry.record_id.hex() for entry in entries],
            "frames": frames,
            "kinds": kinds,
            "visits": visits,
            "recipients": [page_share(share, now_ms, language) for share in recipients],
        }
    )


async def _erase(session: PageSession, request: web.Request) -> web.Response:
    asked = await body_of(request)
    passphrase, ids, frames = asked.text("passphrase"), asked.ids("records"), asked.numbers("frames")
    asked.end()
    entries, frames = _named(session, ids, frames)
    await session.gate.require(passphrase)

    async def work(job: Job) -> Result:
        return await _erase_and_follow(session, job, entries, frames, language_of(request))

    return accepted(session.jobs.start("erase", work))


async def _erase_and_follow(
    session: PageSession, job: Job, entries: list[RecordEntry], frames: list[int], language: str
) -> Result:
    wallet = session.wallet
    job.tell("writing it into the ledger")
    recipients = await SharingClient(wallet).recipients(entries)
    asked = await ErasureClient(wallet).request_each(entries, frames)
    session.clips.forget_records({entry.record_id for entry in entries})
    names = custodian_names(wallet)
    loop = asyncio.get_running_loop()
    over_at = loop.time() + WAIT_MAX_S
    while True:
        found = await _read_asked(session, asked)
        _tell_receipts(job, found, names)
        is_complete = all(each.report.complete for each in found)
        if is_complete or loop.time() >= over_at or session.ended.is_set():
            break
        await asyncio.sleep(_POLL_S)
    now_ms = session.now_ms()
    return {
        "complete": is_complete,
        "erasures": [page_erasure(each, names) for each in found],
        "recipients": [page_share(share, now_ms, language) for share in recipients],
        "sentence": "It is erased everywhere."
        if is_complete
        else "It is asked for, and not confirmed by all yet: custodians go on by themselves.",
    }


async def _read_asked(session: PageSession, asked: list[tuple[KnownVisit, list[bytes]]]) -> list[ErasureProgress]:
    found = []
    for visit, ids in asked:
        every = await find_erasures_of(session.wallet, visit, session.now_ms())
        found += [each for each in every if each.report.erasure_id in ids]
    return found


class PageCustodianAnswer(CustodianAnswer, frozen=True, kw_only=True):
    """What a custodian said of an erasure."""

    erasure_id: Hex


def _tell_receipts(job: Job, found: list[ErasureProgress], names: Mapping[bytes, str]) -> None:
    rows = [
        extend(PageCustodianAnswer, word, erasure_id=each.report.erasure_id.hex())
        for each in found
        for word in erasure_row(each, names).custodians
    ]
    if rows == job.receipts:
        return
    job.receipts = rows
    job.tell("waiting for receipts", sum(row.confirmed_at_ms is not None for row in rows), len(rows))

"""Routes for erasure: preview, confirmation, receipts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from aiohttp import web

from clients.sdk.terminal.json_answers import Hex, extend
from clients.wallet.answers.record_answers import CustodianAnswer
from clients.wallet.ledger.record_filter import Filter
from clients.wallet.page.jobs import Job, Result
from clients.wallet.page.page_answers import accepted, answer_json, body_of, language_of, route
from clients.wallet.page.record_days import kind_of, kinds_json, read_zone, select
from clients.wallet.page.request_fields import RequestFields
from clients.wallet.page.routes.reading_routes import page_erasure, page_share
from clients.wallet.page.session import PageSession
from clients.wallet.presentation.erasure_text import custodian_names, erasure_row
from clients.wallet.records.erasure import WAIT_MAX_S, ErasureClient, ErasurePlan, ErasureReport, plan_erasure
from clients.wallet.records.erasure_status import ErasureProgress, describe_erasure
from clients.wallet.records.viewing import name_places
from clients.wallet.sharing.outgoing_shares import SharingClient
from clients.wallet.text_catalogue import refusal
from consensus.errors import BlockRobotError
from pages.local_page import LocalRoute


def routes(session: PageSession) -> list[LocalRoute]:
    return [
        route(session, "POST", "/api/erasures/plan", _plan),
        route(session, "POST", "/api/erasures", _erase),
    ]


def _plan_of(session: PageSession, ids: list[bytes], frames: list[int]) -> ErasurePlan:
    """From what the page has read. Raises NOT_FOUND, REQUEST_INVALID."""
    entries = [session.snapshot.entry(record_id) for record_id in ids]
    if frames and len(entries) == 1:
        (entry,) = entries
        committed = session.clips.count_committed(entry.record_id)
        count = entry.metadata.frame_count if committed is None else committed
        plan = plan_erasure(entries, frames, count, session.snapshot.part_of(entry.visit.owner).trail)
    else:
        plan = plan_erasure(entries, frames)
    if plan.missing:
        raise refusal("REQUEST_INVALID", "erase_pictures", missing=name_places(plan.missing), count=plan.count)
    if plan.is_empty:
        raise refusal("NOT_FOUND", "erase_nothing")
    return plan


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
    plan = _plan_of(session, ids, frames)
    entries, frames = plan.entries, plan.frames
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
    plan = _plan_of(session, ids, frames)
    await session.gate.require(passphrase)

    async def work(job: Job) -> Result:
        return await _erase_and_follow(session, job, plan, language_of(request))

    return accepted(session.jobs.start("erase", work))


async def _erase_and_follow(session: PageSession, job: Job, plan: ErasurePlan, language: str) -> Result:
    wallet = session.wallet
    erasing, names = ErasureClient(wallet), custodian_names(wallet)
    job.tell("writing it into the ledger")
    recipients = await SharingClient(wallet).recipients(plan.entries)
    requested = await erasing.request_each(plan.entries, plan.frames)
    session.clips.forget_records({entry.record_id for entry in plan.entries})
    found: list[ErasureProgress] = []

    def show(reports: Sequence[ErasureReport]) -> None:
        found[:] = [describe_erasure(each, session.now_ms()) for each in reports]
        _show_receipts(job, found, names)

    try:
        await erasing.wait_complete(requested, WAIT_MAX_S, show, session.ended.is_set)
        is_complete = True
    except BlockRobotError as error:
        if error.code != "ERASURE_NOT_CONFIRMED":
            raise
        is_complete = False
    now_ms = session.now_ms()
    return {
        "complete": is_complete,
        "erasures": [page_erasure(each, names) for each in found],
        "recipients": [page_share(share, now_ms, language) for share in recipients],
        "sentence": "It is erased everywhere."
        if is_complete
        else "It is asked for, and not confirmed by all yet: custodians go on by themselves.",
    }


class PageCustodianAnswer(CustodianAnswer, frozen=True, kw_only=True):
    """What a custodian said of an erasure."""

    erasure_id: Hex


def _show_receipts(job: Job, found: list[ErasureProgress], names: Mapping[bytes, str]) -> None:
    rows = [
        extend(PageCustodianAnswer, word, erasure_id=each.report.erasure_id.hex())
        for each in found
        for word in erasure_row(each, names).custodians
    ]
    if rows == job.receipts:
        return
    job.receipts = rows
    job.tell("waiting for receipts", sum(row.confirmed_at_ms is not None for row in rows), len(rows))

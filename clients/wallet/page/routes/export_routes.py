"""Routes for export: warning, progress, file."""

from __future__ import annotations

import asyncio
import secrets
import threading
from http import HTTPStatus
from pathlib import Path

import msgspec
from aiohttp import web
from aiohttp.abc import AbstractStreamWriter

from clients.bundle.checks.bundle_check import Verdict
from clients.bundle.proving import Heard
from clients.bundle.writing import Contents, write_bundle
from clients.wallet.export.export_building import ExportChoice, Exporter
from clients.wallet.page.jobs import Job, Result
from clients.wallet.page.page_answers import accepted, answer_json, body_of, language_of, route
from clients.wallet.page.request_fields import RequestFields
from clients.wallet.page.session import KeptFile, PageSession
from clients.wallet.presentation.export_text import bundle_warning, export_answer, problem_text
from clients.wallet.presentation.invocation import verify_command
from clients.wallet.text_catalogue import refusal
from pages.local_page import LocalRoute
from pages.time_format import format_date


def routes(session: PageSession) -> list[LocalRoute]:
    return [
        route(session, "POST", "/api/exports/plan", _plan),
        route(session, "POST", "/api/exports", _export),
        route(session, "GET", "/api/exports/{export}/file", _file),
        route(session, "DELETE", "/api/exports/{export}", _forget),
    ]


def _read_wanted(asked: RequestFields) -> tuple[ExportChoice, bool]:
    wanted = ExportChoice(
        records=tuple(asked.ids("records")),
        from_ms=asked.number("from_ms", 0),
        until_ms=asked.number("until_ms", 0),
        pictures=asked.flag("pictures", default=True),
        identity=asked.flag("identity", default=True),
    )
    if wanted.until_ms and wanted.until_ms <= wanted.from_ms:
        raise refusal("REQUEST_INVALID", "time_order")
    return wanted, asked.flag("now", default=False)


async def _plan(session: PageSession, request: web.Request) -> web.Response:
    asked = await body_of(request)
    wanted, now = _read_wanted(asked)
    asked.end()
    async with session.hold() as wallet:
        plan = await Exporter(wallet, at_once=now).plan(wanted)
    lines = [line.strip() for line in bundle_warning(plan, now=now)]
    return answer_json({"visits": len(plan.visits), "records": plan.record_count, "lines": lines})


async def _export(session: PageSession, request: web.Request) -> web.Response:
    asked = await body_of(request)
    passphrase = asked.text("passphrase")
    wanted, now = _read_wanted(asked)
    asked.end()
    await session.gate.require(passphrase)
    language = language_of(request)

    async def work(job: Job) -> Result:
        return await _write(session, job, wanted, language, at_once=now)

    return accepted(session.jobs.start("export", work, stoppable=True))


class _StoppedError(Exception):
    """Nobody waits for what is being written any more."""


async def _write(session: PageSession, job: Job, wanted: ExportChoice, language: str, *, at_once: bool) -> Result:
    loop = asyncio.get_running_loop()

    def heard(what: str, done: int, of: int) -> None:
        loop.call_soon_threadsafe(job.tell, what, done, of)

    exporting, now_ms = Exporter(session.wallet, heard, at_once=at_once), session.now_ms()
    plan = await exporting.plan(wanted)
    contents = await exporting.collect(plan, now_ms)
    name = secrets.token_hex(8)
    path = session.folder / f"export-{name}.zip"
    verdict = await _write_until_stopped(path, contents, heard)
    answer = export_answer(path, verdict)
    session.keep_export(name, path)
    day = format_date(now_ms)
    saved = f"blockrobot-{day}.zip"
    return {
        "export": name,
        "name": saved,
        "check": verify_command(saved),
        "bytes": answer.bytes,
        "is_complete": answer.is_complete,
        "visits": answer.visits,
        "records": answer.records,
        "pictures": answer.pictures,
        "audit_entries": answer.audit_entries,
        "proved_until_height": answer.proved_until_height,
        "problems": [
            msgspec.structs.replace(each, sentence=problem_text(each.code, each.sentence, language))
            for each in answer.problems
        ],
        "lines": [f"Missing: {problem.sentence}" for problem in answer.problems],
    }


async def _write_until_stopped(path: Path, contents: Contents, heard: Heard) -> Verdict:
    """In a thread; cancellation awaits it and leaves no file."""
    stopped = threading.Event()

    def heard_unless_stopped(what: str, done: int, of: int) -> None:
        if stopped.is_set():
            raise _StoppedError
        heard(what, done, of)

    writing = asyncio.ensure_future(asyncio.to_thread(write_bundle, path, contents, heard=heard_unless_stopped))
    try:
        return await asyncio.shield(writing)
    except asyncio.CancelledError:
        stopped.set()
        await asyncio.wait([writing])
        _leave_out(path, writing)
        raise


def _leave_out(path: Path, writing: asyncio.Future[Verdict]) -> None:
    path.unlink(missing_ok=True)
    writing.exception()


class _KeptFileResponse(web.FileResponse):
    """A kept file, marked fetched only when completely sent."""

    def __init__(self, kept: KeptFile) -> None:
        super().__init__(kept.path, headers={"Content-Type": "application/zip"})
        self._kept = kept

    async def prepare(self, request: web.BaseRequest) -> AbstractStreamWriter | None:
        writer = await super().prepare(request)
        if self.status == HTTPStatus.OK:
            self._kept.was_fetched = True
        return writer


async def _file(session: PageSession, request: web.Request) -> web.StreamResponse:
    kept = session.exports.get(request.match_info["export"])
    if kept is None:
        raise refusal("NOT_FOUND", "page_no_file")
    return _KeptFileResponse(kept)


async def _forget(session: PageSession, request: web.Request) -> web.Response:
    session.forget_export(request.match_info["export"])
    return answer_json({})

"""A custodian's maintenance routes on the operator's listener, by token only.

Long tasks stream JSON lines: `{"progress": ...}`, then `{"report": ...}` or `{"error": ...}`.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from contextlib import suppress
from functools import partial

import msgspec
import structlog
from aiohttp import web

from consensus.api_documents import Document
from consensus.errors import BlockRobotError
from consensus.records.envelopes import RECORD_ID_BYTES
from node.custody.coordination.custody_admin import CustodyAdmin
from node.custody.coordination.custody_answers import CustodyProblem, Progress, WorkLine
from node.custody.repair.scrub import Tell

TELL_EVERY_S = 0.2
HEARTBEAT_S = 10.0
Work = Callable[[Tell], Awaitable[Document]]
_ROUTE_WORK: dict[str, Callable[[CustodyAdmin, web.Request], Work]] = {
    "/custody/scrub": lambda admin, request: partial(admin.scrub, after=_read_after(request)),
    "/custody/rebuild": lambda admin, _request: admin.rebuild,
}

log = structlog.get_logger(__name__)


def _problem_of(error: BlockRobotError) -> CustodyProblem:
    return CustodyProblem(code=error.code, detail=error.detail, next_step=error.next_step)


def _read_after(request: web.Request) -> bytes:
    text = request.query.get("after", "")
    try:
        after = bytes.fromhex(text)
    except ValueError:
        after = b"?"
    if text and len(after) != RECORD_ID_BYTES:
        raise BlockRobotError("REQUEST_INVALID", "`after` is no record id.")
    return after


def _answer(document: Document, status: int = 200) -> web.Response:
    return web.Response(body=msgspec.json.encode(document), status=status, content_type="application/json")


def add_custody_routes(
    application: web.Application, custody_admin: CustodyAdmin | None, require: Callable[[web.Request], None]
) -> None:
    """Add the routes; `require` raises unless the request is the operator's."""

    def permitted(request: web.Request) -> CustodyAdmin:
        require(request)
        if custody_admin is None:
            raise BlockRobotError("CUSTODY_ELSEWHERE")
        return custody_admin

    async def status(request: web.Request) -> web.StreamResponse:
        try:
            return _answer(await permitted(request).status())
        except BlockRobotError as error:
            return _answer(_problem_of(error), error.entry.status)

    async def work(request: web.Request) -> web.StreamResponse:
        try:
            run = _ROUTE_WORK[request.path](permitted(request), request)
        except BlockRobotError as error:
            return _answer(_problem_of(error), error.entry.status)
        return await _stream(request, run)

    application.router.add_get("/custody", status)
    for path in _ROUTE_WORK:
        application.router.add_post(path, work)


async def _stream(request: web.Request, run: Work) -> web.StreamResponse:
    newest: list[Progress] = []
    newest_line, line_at_s = Progress(what="working", done=0, total=0), time.monotonic()

    def tell(what: str, done: int, total: int, last: bytes = b"") -> None:
        newest.append(Progress(what=what, done=done, total=total, last=last.hex()))

    response = web.StreamResponse(headers={"Content-Type": "application/x-ndjson"})
    await response.prepare(request)

    async def say(line: WorkLine) -> None:
        await response.write(msgspec.json.encode(line) + b"\n")

    task = asyncio.ensure_future(run(tell))
    try:
        while not task.done():
            await asyncio.wait([task], timeout=TELL_EVERY_S)
            is_due = bool(newest) or time.monotonic() - line_at_s >= HEARTBEAT_S
            if is_due and not task.done():
                newest_line, line_at_s = newest[-1] if newest else newest_line, time.monotonic()
                newest.clear()
                await say(WorkLine(progress=newest_line))
        try:
            await say(WorkLine(report=msgspec.Raw(msgspec.json.encode(task.result()))))
        except BlockRobotError as error:
            await say(WorkLine(error=_problem_of(error)))
        except Exception:
            log.exception("custody_upkeep_fault", path=request.path)
            await say(WorkLine(error=_problem_of(BlockRobotError("INTERNAL"))))
    finally:
        if not task.done():
            task.cancel()
            with suppress(asyncio.CancelledError, BlockRobotError):
                await task
    await response.write_eof()
    return response

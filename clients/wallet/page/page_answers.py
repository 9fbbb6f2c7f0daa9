"""Page answers, localised."""

from __future__ import annotations

import json
from collections.abc import Awaitable, Callable, Mapping, Sequence

import msgspec
from aiohttp import web

from clients.wallet.page.jobs import Job, Result
from clients.wallet.page.record_seals import verified_block
from clients.wallet.page.request_fields import RequestFields
from clients.wallet.page.session import PageSession
from clients.wallet.presentation.translations import LANGUAGES, describe_error, language_in_use
from consensus.errors import BlockRobotError
from pages.local_page import PROBLEM_TYPE, Handler, LocalRoute, read_object

QUIET_HEADER = "X-BlockRobot-Quiet-Ms"
"""How long ago the user last touched the page: it asks by itself too, whenever there is news."""
VERIFIED_HEADER = "X-BlockRobot-Verified"
"""The height and the time, in ms, of the block against which the wallet checks when it answers."""
Answer = Callable[[PageSession, web.Request], Awaitable[web.StreamResponse]]


def language_of(request: web.Request) -> str:
    wanted = request.headers.get("Accept-Language", "")[:2].lower()
    return wanted if wanted in LANGUAGES else language_in_use()


class ProblemDocument(msgspec.Struct, frozen=True, kw_only=True):
    """A problem document (RFC 9457)."""

    type: str
    title: str
    status: int
    code: str
    detail: str
    next_step: str
    retryable: bool


def page_problem(error: BlockRobotError, language: str) -> ProblemDocument:
    """Return a localised problem (RFC 9457)."""
    detail, next_step = describe_error(error, language)
    return ProblemDocument(
        type=f"urn:blockrobot:error:{error.code}",
        title=error.entry.meaning,
        status=error.entry.status,
        code=error.code,
        detail=detail,
        next_step=next_step,
        retryable=error.entry.retryable,
    )


def _note_use(session: PageSession, request: web.Request, *, is_use: bool) -> None:
    quiet = request.headers.get(QUIET_HEADER, "")
    if quiet.isascii() and quiet.isdigit() and len(quiet) <= 12:
        session.note_use(int(quiet))
    elif is_use:
        session.note_use()


def route(session: PageSession, method: str, path: str, answer: Answer, *, is_use: bool = True) -> LocalRoute:
    """`is_use` resets the idle timer by default."""
    return LocalRoute(method, path, _handler(session, answer, is_use=is_use))


def _handler(session: PageSession, answer: Answer, *, is_use: bool) -> Handler:
    async def handle(request: web.Request) -> web.StreamResponse:
        _note_use(session, request, is_use=is_use)
        try:
            response = await answer(session, request)
        except BlockRobotError as error:
            body = msgspec.json.encode(page_problem(error, language_of(request)))
            return web.Response(status=error.entry.status, body=body, content_type=PROBLEM_TYPE)
        if not response.prepared:
            block = verified_block(session.wallet)
            response.headers[VERIFIED_HEADER] = f"{block.height} {block.time_ms}"
        return response

    return handle


def answer_json(value: Mapping[str, object] | msgspec.Struct, status: int = 200) -> web.Response:
    """Structs may be anywhere in it."""
    body = json.dumps(msgspec.to_builtins(value, builtin_types=(bytes,))).encode()  # refuses bytes: no silent base64
    return web.Response(status=status, body=body, content_type="application/json")


def accepted(job: Job) -> web.Response:
    return answer_json({"job": job.name}, status=202)


async def body_of(request: web.Request) -> RequestFields:
    return RequestFields(await read_object(request) if request.can_read_body else {})


def query_of(request: web.Request) -> RequestFields:
    return RequestFields(request.query)


class PageJob(msgspec.Struct, frozen=True, kw_only=True):
    """How far a job is."""

    job: str
    kind: str
    revision: int
    state: str
    step: str
    done: int
    of: int
    stoppable: bool
    result: Result | None
    error: ProblemDocument | None
    receipts: Sequence[msgspec.Struct] | msgspec.UnsetType


def page_job(job: Job, language: str) -> PageJob:
    return PageJob(
        job=job.name,
        kind=job.kind,
        revision=job.revision,
        state=job.state,
        step=job.step,
        done=job.done,
        of=job.of,
        stoppable=job.is_stoppable and not job.is_over,
        result=job.result,
        error=None if job.error is None else page_problem(job.error, language),
        receipts=msgspec.UNSET if job.receipts is None else job.receipts,
    )

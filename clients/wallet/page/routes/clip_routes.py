"""Routes that request, fetch, check and open records."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping

from aiohttp import web

from clients.sdk.pictures.depth_colours import Depth
from clients.wallet.ledger.visit_audit import audit_visit, findings_of
from clients.wallet.ledger.wallet import RecordEntry
from clients.wallet.page.jobs import Job, Result
from clients.wallet.page.open_clips import CLIP_MAX_BYTES, RECORDS_MAX_COUNT, OpenClip, little_endian, size_of
from clients.wallet.page.page_answers import accepted, answer_json, body_of, language_of, query_of, route
from clients.wallet.page.record_seals import Seal, page_seal, verified_block
from clients.wallet.page.session import LOOK_NAME_MAX_CHARS, PageSession
from clients.wallet.records.viewing import RecordView, RecordViewer, finding_of
from clients.wallet.text_catalogue import refusal
from consensus.errors import BlockRobotError
from consensus.records.renditions import ENCODING_PNG16
from pages.local_page import LocalRoute

_ACCESS_IS_OVER = frozenset({"ACCESS_ENDED", "ACCESS_NOT_GRANTED"})
WIDTH_HEADER, HEIGHT_HEADER = "X-BlockRobot-Width", "X-BlockRobot-Height"


def routes(session: PageSession) -> list[LocalRoute]:
    frame = "/api/clips/{clip}/frames/{number}"
    return [
        route(session, "POST", "/api/clips", _open),
        route(session, "GET", "/api/clips/{clip}", _clip),
        route(session, "DELETE", "/api/clips/{clip}", _forget),
        route(session, "POST", "/api/clips/{clip}/verdict", _judge),
        route(session, "GET", f"{frame}/depth", _depth),
        route(session, "GET", f"{frame}/file", _file),
        route(session, "GET", f"{frame}/depth.png", _own_png),
    ]


async def _open(session: PageSession, request: web.Request) -> web.Response:
    asked = await body_of(request)
    ids, purpose = asked.ids("records"), asked.text("purpose", "own-access")
    look, whole = asked.text("look", "", max_chars=LOOK_NAME_MAX_CHARS), asked.flag("meeting", default=False)
    asked.end()
    entries = [session.snapshot.entry(record_id) for record_id in ids]
    if not 1 <= len(entries) <= RECORDS_MAX_COUNT:
        raise refusal("REQUEST_INVALID", "clip_records", most=RECORDS_MAX_COUNT)
    if len({entry.visit.owner for entry in entries}) > 1:
        raise refusal("REQUEST_INVALID", "clip_one_visit")

    language = language_of(request)

    async def work(job: Job) -> Result:
        job.tell("asking on the ledger", 0, len(entries))
        now = await _as_of_now(session, entries)
        wanted = [entry for entry in now.values() if entry.state.status == "active"]
        wanted = wanted if whole else [now[entry.record_id] for entry in entries]
        viewing = RecordViewer(session.wallet)
        access = await session.looks.request(viewing, look, purpose, wanted)
        try:
            return await open_records(session, job, viewing, [now[record_id] for record_id in ids], access, language)
        except BlockRobotError as error:
            if error.code in _ACCESS_IS_OVER:
                session.looks.forget(look)
            raise

    return accepted(session.jobs.start("clip", work, stoppable=True))


async def open_records(
    session: PageSession,
    job: Job,
    viewing: RecordViewer,
    entries: list[RecordEntry],
    access: Mapping[bytes, bytes],
    language: str,
) -> Result:
    """By access ids; `records` says how many fitted."""
    views: list[RecordView] = []
    rooms: dict[bytes, bytes] = {}
    held_bytes = 0
    for entry in entries:
        view = await viewing.view(entry, access[entry.record_id])
        views.append(view)
        await _add_rooms(viewing, view, rooms)
        job.tell("fetching and checking", len(views), len(entries))
        held_bytes += size_of(view)
        if held_bytes + sum(map(len, rooms.values())) >= CLIP_MAX_BYTES:
            break
    block, now_ms = verified_block(session.wallet), session.now_ms()
    seals = [Seal(view, block, now_ms) for view in views]
    clip = session.clips.add(seals, rooms, viewing.missing_rooms)
    answers = [page_seal(seal, language) for seal in seals]
    return {"clip": clip.name, "seals": answers, "frames": len(clip.frames), "records": len(views)}


async def _judge(session: PageSession, request: web.Request) -> web.Response:
    """Check what is open, without fetching it again."""
    clip, language = _clip_of(session, request), language_of(request)

    async def work(job: Job) -> Result:
        job.tell("asking on the ledger", 0, len(clip.views))
        visit = clip.views[0].entry.visit
        await RecordViewer(session.wallet).put_verdicts(visit, [finding_of(view) for view in clip.views])
        trail = await audit_visit(session.wallet, visit)
        heights = {found[0]: entry.height for entry in trail for found in findings_of(entry)}
        clip.note_verdicts(heights)
        return {"clip": clip.name, "seals": [page_seal(seal, language) for seal in clip.seals]}

    return accepted(session.jobs.start("verify", work, stoppable=False))


async def _add_rooms(viewing: RecordViewer, view: RecordView, rooms: dict[bytes, bytes]) -> None:
    for frame in view.frames:
        room = frame.rendition
        if room is None or room.encoding != ENCODING_PNG16 or not room.pixels or room.background_id in rooms:
            continue
        found = await viewing.background(room, view.entry)
        if found is not None:
            rooms[room.background_id] = found


async def _as_of_now(session: PageSession, entries: list[RecordEntry]) -> dict[bytes, RecordEntry]:
    """Raises NOT_FOUND."""
    visit = entries[0].visit
    part = session.snapshot.part_of(visit.owner)
    report = part.report
    if await session.wallet.visit_mark(visit) != part.mark:
        report = await session.wallet.visit_report(visit)
    known = {entry.record_id: entry for entry in report.records}
    if any(entry.record_id not in known for entry in entries):
        raise refusal("CLIP_ERASED", "erased_now")
    return known


# What is open


def _number(request: web.Request) -> int:
    text = request.match_info["number"]
    if not (text.isascii() and text.isdigit() and len(text) < 9):
        raise refusal("NOT_FOUND", "clip_no_frame")
    return int(text)


def _clip_of(session: PageSession, request: web.Request) -> OpenClip:
    return session.clips.find(request.match_info["clip"])


async def _clip(session: PageSession, request: web.Request) -> web.Response:
    return answer_json(_clip_of(session, request).page_clip(language_of(request)))


async def _forget(session: PageSession, request: web.Request) -> web.Response:
    session.clips.forget(request.match_info["clip"])
    return answer_json({})


async def _depth(session: PageSession, request: web.Request) -> web.Response:
    asked = query_of(request)
    own = asked.flag("own", default=False)
    asked.end()
    clip, number = _clip_of(session, request), _number(request)

    def draw() -> tuple[Depth, bytes]:
        depth = clip.depth(number, own=own)
        return depth, little_endian(depth)

    depth, body = await asyncio.to_thread(draw)
    size = {WIDTH_HEADER: str(depth.shape[1]), HEIGHT_HEADER: str(depth.shape[0])}
    return web.Response(body=body, headers=size, content_type="application/octet-stream")


async def _file(session: PageSession, request: web.Request) -> web.Response:
    clip, number = _clip_of(session, request), _number(request)
    media_type, body = await asyncio.to_thread(clip.file, number)
    return web.Response(body=body, content_type=media_type)


async def _own_png(session: PageSession, request: web.Request) -> web.Response:
    clip, number = _clip_of(session, request), _number(request)
    return web.Response(body=await asyncio.to_thread(clip.own_png, number), content_type="image/png")

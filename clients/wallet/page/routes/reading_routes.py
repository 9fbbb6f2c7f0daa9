"""Routes answered from the snapshot, without network."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from aiohttp import web

from clients.sdk.node_answers import FAULTY
from clients.sdk.pictures.depth_colours import scale_json
from clients.sdk.terminal.json_answers import Answer, Hex, extend
from clients.wallet.answers.record_answers import ErasureRow, VisitRightsRow
from clients.wallet.answers.sharing_answers import OwnShare
from clients.wallet.ledger.record_filter import Filter
from clients.wallet.ledger.visit_audit import AuditEntry, findings_of, records_of
from clients.wallet.ledger.wallet import RecordEntry
from clients.wallet.page.jobs import WAIT_MAX_MS
from clients.wallet.page.page_answers import answer_json, language_of, page_job, page_problem, query_of, route
from clients.wallet.page.record_days import (
    RecordShown,
    kinds_json,
    read_zone,
    recordings,
    select,
    show_days,
    show_record,
    show_visit,
    withheld_count,
)
from clients.wallet.page.record_seals import verified_block
from clients.wallet.page.request_fields import RequestFields, read_id
from clients.wallet.page.session import UNKNOWN_YET, PageSession
from clients.wallet.page.wallet_snapshot import VisitPart
from clients.wallet.presentation.audit_story import PageEvent, page_event
from clients.wallet.presentation.erasure_text import custodian_names, erasure_lines, erasure_row
from clients.wallet.presentation.former_text import member_gone_line, words_lines
from clients.wallet.presentation.guardian_lines import guardian_lines
from clients.wallet.presentation.share_text import name_recipient, own_share, share_lines
from clients.wallet.presentation.translations import LANGUAGES, language_in_use, section
from clients.wallet.records.erasure_status import ErasureProgress
from clients.wallet.sharing.outgoing_shares import Share
from consensus.errors import BlockRobotError
from consensus.rights.purposes import PURPOSES
from consensus.rights.sensors import SENSORS
from pages.local_page import LocalRoute

PAGE_RECORDS_COUNT, RECORDS_MAX_COUNT = 200, 2_000
PAGE_EVENTS_COUNT, EVENTS_MAX_COUNT = 100, 1_000
NEW_RECORDS_MAX_COUNT = 100
_DAY_MINUTES = 24 * 60


def routes(session: PageSession) -> list[LocalRoute]:
    return [
        route(session, "GET", "/api/overview", _overview),
        route(session, "GET", "/api/texts", _texts),
        route(session, "GET", "/api/changes", _changes, is_use=False),
        route(session, "POST", "/api/refresh", _refresh),
        route(session, "POST", "/api/end", _end),
        route(session, "GET", "/api/jobs/{job}", _job, is_use=False),
        route(session, "POST", "/api/jobs/{job}/cancel", _cancel),
        route(session, "GET", "/api/days", _days),
        route(session, "GET", "/api/records", _records),
        route(session, "GET", "/api/records/{record}", _record),
        route(session, "GET", "/api/audit-events", _audit_events),
        route(session, "GET", "/api/shares", _shares),
        route(session, "GET", "/api/erasures", _erasures),
    ]


# The page as a whole


async def _overview(session: PageSession, request: web.Request) -> web.Response:
    wallet, language = session.wallet, language_of(request)
    content, snapshot, genesis = wallet.store.content, session.snapshot, wallet.genesis
    block = verified_block(wallet)
    notice = snapshot.notice
    return answer_json(
        {
            "person": {
                "profile": session.profile,
                "command": session.command,
                "registered": bool(content.handle),
                "handle": content.handle.hex() or None,
                "role": content.role,
                "member_gone": wallet.member_gone,
                "left": content.left,
            },
            "network": {
                "name": genesis.network,
                "chain_id": genesis.chain_id.hex(),
                "purposes": {code: PURPOSES.get(code, code) for code in genesis.purposes},
                "sensors": SENSORS,
                "custodians": [node.name for node in wallet.network.custody.custodians],
                "nodes": _page_nodes(session, language),
            },
            "verified": {"height": block.height, "time_ms": block.time_ms, "block_id": block.block_id.hex()},
            "state": session.state,
            "problem": None if session.problem is None else page_problem(session.problem, language),
            "refreshed_at_ms": snapshot.read_at_ms or None,
            "warnings": [*member_gone_line(wallet, language), *words_lines(content, language)],
            "counts": _counts(session),
            "guardians": [line._asdict() for line in guardian_lines(content, language)],
            "notice": None
            if notice is None
            else {
                "organisation": notice.organisation,
                "version": notice.version,
                "changed": 0 < content.notice_consented_version < notice.version,
                "never_shown": notice.version > content.notice_shown_version,
            },
            "depth_scale": scale_json(),
            "news": session.news,
        }
    )


def _node_state(error: BlockRobotError) -> str:
    if error.code in FAULTY:
        return "lied"
    return {"NODE_UNREACHABLE": "unreachable", UNKNOWN_YET: "behind"}.get(error.code, "refused")


class PageNode(Answer, frozen=True, kw_only=True):
    """How a node answers."""

    name: str
    state: str
    code: str | None
    sentence: str | None


def _page_nodes(session: PageSession, language: str) -> list[PageNode]:
    troubles, rows = session.node_troubles(), []
    for node in session.wallet.network.nodes:
        error = troubles.get(node.name)
        state = "fine" if error is None else _node_state(error)
        sentence = None if error is None or state == "behind" else page_problem(error, language).detail
        code = None if error is None else error.code
        rows.append(PageNode(name=node.name, state=state, code=code, sentence=sentence))
    return rows


def _counts(session: PageSession) -> Mapping[str, object]:
    snapshot, now_ms = session.snapshot, session.now_ms()
    entries = list(snapshot.entries.values())
    return {
        "visits": len(snapshot.visits),
        "records": len(recordings(entries)),
        "notices": len(entries) - len(recordings(entries)),
        "kinds": kinds_json(entries),
        "withheld": withheld_count(entries),
        "shares_open": sum(share.grant.row.is_open(now_ms) for share in snapshot.shares()),
        "erasures_open": sum(not erasure.report.complete for erasure in snapshot.erasures(now_ms)),
        "alarms": sum(part.is_alarming for part in snapshot.visits),
        "inbox_news": sum(len(share.looks) for share in snapshot.shares()),
    }


async def _texts(_session: PageSession, request: web.Request) -> web.Response:
    asked = query_of(request)
    language = asked.text("language", "") or language_in_use()
    asked.end()
    if language not in LANGUAGES:
        raise BlockRobotError("REQUEST_INVALID", f"The wallet speaks {', '.join(LANGUAGES)}.")
    texts = section("page", language)
    response = answer_json({"language": language, "languages": list(LANGUAGES), "texts": texts})
    response.enable_compression()
    return response


async def _changes(session: PageSession, request: web.Request) -> web.Response:
    asked = query_of(request)
    after, wait_ms = asked.number("after", 0), asked.number("wait_ms", 0, most=WAIT_MAX_MS)
    asked.end()
    new = await session.wait_news(after, wait_ms)
    return answer_json(
        {
            "news": session.news,
            "state": session.state,
            "refreshed_at_ms": session.snapshot.read_at_ms or None,
            "new_records": [record_id.hex() for record_id in new[-NEW_RECORDS_MAX_COUNT:]],
            "problem": None if session.problem is None else page_problem(session.problem, language_of(request)),
        }
    )


async def _refresh(session: PageSession, _request: web.Request) -> web.Response:
    session.look_again()
    return answer_json({}, status=202)


async def _end(session: PageSession, _request: web.Request) -> web.Response:
    session.ended.set()
    return answer_json({})


async def _job(session: PageSession, request: web.Request) -> web.Response:
    asked = query_of(request)
    after, wait_ms = asked.number("after", 0), asked.number("wait_ms", 0, most=WAIT_MAX_MS)
    asked.end()
    job = await session.jobs.wait(request.match_info["job"], after, wait_ms)
    return answer_json(page_job(job, language_of(request)))


async def _cancel(session: PageSession, request: web.Request) -> web.Response:
    return answer_json({"state": session.jobs.cancel(request.match_info["job"]).state})


# Records


def read_query(asked: RequestFields) -> tuple[Filter, str]:
    day, zone = asked.text("day", "", max_chars=10), asked.text("zone", "")
    robot, sensor = asked.text("robot", "", max_chars=66).lower(), asked.text("sensor", "", max_chars=64)
    first = asked.number("from_minute", 0, most=_DAY_MINUTES)
    end = asked.number("until_minute", _DAY_MINUTES, most=_DAY_MINUTES)
    wanted = Filter(
        (day, day) if day else None,
        None if (first, end) == (0, _DAY_MINUTES) else (first, end),
        (robot,) if robot else (),
        (sensor,) if sensor else (),
        visit=asked.text("visit", "", max_chars=66).lower(),
        from_ms=asked.number("from_ms", 0),
        until_ms=asked.number("until_ms", 0),
        zone=read_zone(zone),
    )
    return wanted, zone


async def _days(session: PageSession, request: web.Request) -> web.Response:
    asked = query_of(request)
    wanted, zone = read_query(asked)
    asked.end()
    return answer_json(show_days(session.snapshot, wanted, zone, language_of(request)))


async def _records(session: PageSession, request: web.Request) -> web.Response:
    asked = query_of(request)
    wanted, _ = read_query(asked)
    limit = asked.number("limit", PAGE_RECORDS_COUNT, least=1, most=RECORDS_MAX_COUNT)
    start = asked.number("cursor", 0)
    asked.end()
    found, now_ms = select(session.snapshot, wanted), session.now_ms()
    rows = [
        show_record(part, entry, now_ms, session.snapshot.robot_names) for part, entry in found[start : start + limit]
    ]
    end = start + limit
    return answer_json({"total": len(found), "next": str(end) if end < len(found) else None, "records": rows})


class WithheldCount(Answer, frozen=True, kw_only=True):
    """Why frames were kept back."""

    reason: str
    count: int
    sentence: str


class RecordDetails(RecordShown, frozen=True, kw_only=True):
    """A record with all that is known of it."""

    txid: Hex | None
    commitment_root: Hex | None
    ciphertext_root: Hex | None
    width: int
    height_px: int
    withheld_reasons: list[WithheldCount]
    rights: VisitRightsRow
    rights_lines: list[str]
    previous: Hex | None
    next: Hex | None
    shares: list[PageShare]
    events: list[PageEvent]
    clip: str | None


async def _record(session: PageSession, request: web.Request) -> web.Response:
    snapshot, now_ms = session.snapshot, session.now_ms()
    entry = snapshot.entry(read_id(request.match_info["record"]))
    part = snapshot.part_of(entry.visit.owner)
    meta, visit = entry.metadata, show_visit(part, language_of(request))
    shares = [share for share in part.shares if entry.record_id in share.left]
    trail = [_only_of(entry.record_id, each) for each in part.trail if _is_about(part, entry, each)]
    return answer_json(
        extend(
            RecordDetails,
            show_record(part, entry, now_ms, snapshot.robot_names),
            txid=plain_hex(entry.state.txid),
            commitment_root=plain_hex(entry.state.commitment_root),
            ciphertext_root=plain_hex(entry.state.ciphertext_root),
            width=meta.width,
            height_px=meta.height,
            withheld_reasons=[
                WithheldCount(reason=reason, count=count, sentence=reason) for reason, count in meta.withheld
            ],
            rights=visit.rights,
            rights_lines=visit.rights_lines,
            **_neighbours(part, entry),
            shares=[page_share(share, now_ms, language_of(request)) for share in shares],
            events=_events(session, trail, language_of(request)),
            clip=session.clips.with_record(entry.record_id),
        )
    )


def _only_of(record_id: bytes, event: AuditEntry) -> AuditEntry:
    own = [list(finding) for finding in findings_of(event) if finding[0] == record_id]
    return replace(event, record_id=record_id, data={"verdict": own[0][1], "findings": own}) if own else event


def _is_about(part: VisitPart, entry: RecordEntry, event: AuditEntry) -> bool:
    """Grant looks name only a number of records, so apply to each."""
    record_id, named = entry.record_id, records_of(event)
    if named:
        return record_id in named
    if "erasure_id" in event.data:  # of several records, which the request names and the trail counts
        asked = (report for report in part.erasures if report.erasure_id == event.data["erasure_id"])
        return any(record_id in report.state.records for report in asked)
    if event.kind == "access_requested" and event.data["records"] == 0:
        return event.height >= entry.state.height
    grant_id = event.data.get("grant_id", event.data.get("grant"))
    return any(share.grant.grant_id == grant_id and record_id in share.grant.row.records for share in part.shares)


def plain_hex(value: bytes | None) -> str | None:
    return None if value is None else value.hex()


def _neighbours(part: VisitPart, entry: RecordEntry) -> dict[str, str | None]:
    ids = [each.record_id.hex() for each in part.report.records]
    place = ids.index(entry.record_id.hex())
    return {
        "previous": ids[place - 1] if place else None,
        "next": ids[place + 1] if place + 1 < len(ids) else None,
    }


# What happened


def _events(session: PageSession, trail: Sequence[AuditEntry], language: str) -> list[PageEvent]:
    names = custodian_names(session.wallet, language)
    ordered = sorted(trail, key=lambda entry: (entry.height, entry.index), reverse=True)
    return [page_event(entry, names, language) for entry in ordered]


async def _audit_events(session: PageSession, request: web.Request) -> web.Response:
    asked = query_of(request)
    record, visit = asked.text("record", "", max_chars=64), asked.text("visit", "", max_chars=66)
    limit = asked.number("limit", PAGE_EVENTS_COUNT, least=1, most=EVENTS_MAX_COUNT)
    start = asked.number("cursor", 0)
    asked.end()
    trail = [
        entry
        for part in session.snapshot.visits
        if not visit or part.report.visit.owner.hex() == visit.lower()
        for entry in part.trail
        if not record or entry.record_id.hex() == record.lower()
    ]
    trail.sort(key=lambda entry: (entry.height, entry.index), reverse=True)
    end = start + limit
    events = _events(session, trail[start:end], language_of(request))
    return answer_json({"total": len(trail), "next": str(end) if end < len(trail) else None, "events": events})


class PageShare(OwnShare, frozen=True, kw_only=True):
    """A grant of one's own."""

    who: str
    purpose_sentence: str
    lines: list[str]


def page_share(share: Share, now_ms: int, language: str) -> PageShare:
    purpose = share.grant.row.purpose
    return extend(
        PageShare,
        own_share(share, now_ms),
        who=name_recipient(share, language),
        purpose_sentence=PURPOSES.get(purpose, purpose),
        lines=share_lines(share, now_ms),
    )


async def _shares(session: PageSession, request: web.Request) -> web.Response:
    now_ms, language = session.now_ms(), language_of(request)
    people = {given.handle: given.label for given in session.wallet.store.content.given_grants}
    return answer_json(
        {
            "shares": [page_share(share, now_ms, language) for share in session.snapshot.shares()],
            "people": [{"handle": handle.hex(), "name": label} for handle, label in people.items()],
        }
    )


class PageErasure(ErasureRow, frozen=True, kw_only=True):
    """A request to erase."""

    lines: list[str]


def page_erasure(erasure: ErasureProgress, names: Mapping[bytes, str]) -> PageErasure:
    return extend(PageErasure, erasure_row(erasure, names), lines=erasure_lines(erasure, names))


async def _erasures(session: PageSession, _request: web.Request) -> web.Response:
    found = session.snapshot.erasures(session.now_ms())
    names = custodian_names(session.wallet)
    return answer_json({"erasures": [page_erasure(each, names) for each in found]})

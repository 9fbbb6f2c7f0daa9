"""Announcements of visits and of their new owner keys, for wallets to scan."""

from __future__ import annotations

from aiohttp import web

from consensus.api_documents import (
    ANNOUNCEMENTS_PAGE_MAX_COUNT,
    AnnouncementItem,
    AnnouncementsAnswer,
    describe,
    finality_document,
)
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode_value
from consensus.state.records import ANNOUNCEMENT, ANNOUNCEMENT_COUNT
from node.api.access.metering import Steps
from node.api.access.route_access import MEMBER
from node.api.routes.proofs import prove_keys
from node.api.routing import JSON, Answer, Call, Parameter, Route, json_answer
from node.storage.ledger_view import LedgerView


def _item(number: int, data: bytes) -> AnnouncementItem:
    try:
        row = ANNOUNCEMENT.convert(decode_value(data))
    except BlockRobotError as error:
        raise BlockRobotError("STORAGE_DAMAGED", f"Announcement {number} cannot be read: {error.detail}") from None
    return describe(AnnouncementItem, row, number=number, root=row.root.hex() or None)


def _read_page(snapshot: LedgerView, first: int, limit: int) -> Steps[web.Response]:
    count = ANNOUNCEMENT_COUNT.read(snapshot) or 0
    keys = [ANNOUNCEMENT_COUNT.flat]
    keys += [ANNOUNCEMENT.key(number) for number in range(first, min(first + limit, count))]
    proofs = yield from prove_keys(snapshot, keys)
    items = [_item(first + offset, bytes.fromhex(proof.value or "")) for offset, proof in enumerate(proofs[1:])]
    yield
    return json_answer(
        AnnouncementsAnswer(count=count, items=items, finality=finality_document(snapshot.finality), proofs=proofs)
    )


async def _list_announcements(call: Call) -> web.StreamResponse:
    first, limit = call.int_of("from"), call.int_of("limit")
    return await call.read(lambda snapshot: _read_page(snapshot, first, limit))


ROUTES = (
    Route(
        "GET",
        "/v1/announcements",
        "listAnnouncements",
        "Opened visits by number. The first proof is that of the count, the others are those of the items.",
        MEMBER,
        _list_announcements,
        Answer(JSON, AnnouncementsAnswer, "A page of announcements with proofs."),
        parameters=(
            Parameter("from", "query", "The first number.", default=0),
            Parameter("limit", "query", "How many at most.", None, 1, ANNOUNCEMENTS_PAGE_MAX_COUNT, 50),
        ),
    ),
)

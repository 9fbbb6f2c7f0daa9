"""Announcements of visits and of their new owner keys, for wallets to scan. Must never leave one out: all is proved."""

from __future__ import annotations

from typing import Any

from aiohttp import web

from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode_value, u64
from node.api.access import MEMBER
from node.api.documents import AnnouncementItem, AnnouncementsAnswer, finality_document
from node.api.metering import Steps
from node.api.routes.proofs import prove_keys
from node.api.routing import JSON, Answer, Call, Parameter, Route, json_answer
from node.api.services import LedgerSnapshot
from node.api.standing import read_value, state_key

ANNOUNCEMENTS_PAGE_MAX_COUNT = 200
_CONTRACT = "records"


def _item(number: int, value: Any) -> AnnouncementItem:
    if not isinstance(value, list) or len(value) not in {5, 6}:
        raise BlockRobotError("STORAGE_DAMAGED", f"Announcement {number} does not have its five or six parts.")
    owner, ephemeral, view_tag, bucket_ms, robot, *root = value
    return AnnouncementItem(
        number=number,
        owner=owner.hex(),
        ephemeral=ephemeral.hex(),
        view_tag=view_tag,
        bucket_ms=bucket_ms,
        robot=robot.hex(),
        root=root[0].hex() if root else None,
    )


def _read_page(snapshot: LedgerSnapshot, first: int, limit: int) -> Steps[web.Response]:
    count = read_value(snapshot, _CONTRACT, b"announcement-count") or 0
    keys = [state_key(_CONTRACT, b"announcement-count")]
    keys += [state_key(_CONTRACT, b"announcement/" + u64(n)) for n in range(first, min(first + limit, count))]
    proofs = yield from prove_keys(snapshot, keys)
    items = [
        _item(first + offset, decode_value(bytes.fromhex(proof.value or ""))) for offset, proof in enumerate(proofs[1:])
    ]
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

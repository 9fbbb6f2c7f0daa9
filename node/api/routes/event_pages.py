"""Contract events, page by page; places (height:index) are alike at every node."""

from __future__ import annotations

from collections.abc import Iterator

from aiohttp import web

from consensus.api_documents import PAGE_MAX_COUNT, EventItem, EventsPage
from consensus.chain.block import ContractEvent
from consensus.errors import BlockRobotError
from node.api.access.metering import Steps
from node.api.access.route_access import MEMBER
from node.api.routes.transactions import WAIT_MAX_MS
from node.api.routing import JSON, Answer, Call, Parameter, Route, json_answer
from node.storage.ledger_view import LedgerView, require_not_pruned

SCAN_MAX_COUNT = 1_000
SCAN_AT_ONCE_COUNT = 100
PLACE_PATTERN = "^[0-9]{1,15}:[0-9]{1,9}$"


def _read_place(text: str | None, snapshot: LedgerView) -> tuple[int, int]:
    if text is None:
        return snapshot.earliest_height, 0
    height, _, index = text.partition(":")
    if not (text.isascii() and height.isdigit() and index.isdigit() and len(height) <= 15 and len(index) <= 9):
        raise BlockRobotError("REQUEST_INVALID", "The place has the form height:index.")
    return int(height), int(index)


def _scan(snapshot: LedgerView, height: int, index: int) -> Iterator[tuple[int, int, ContractEvent] | None]:
    place, left = (height, index), SCAN_MAX_COUNT
    while left > 0:
        yield None
        count = min(left, SCAN_AT_ONCE_COUNT)
        rows = snapshot.events(*place, count)
        yield from rows
        if len(rows) < count:
            return
        place, left = (rows[-1][0], rows[-1][1] + 1), left - count


def _read_page(call: Call, snapshot: LedgerView) -> Steps[EventsPage]:
    """Raises BLOCK_PRUNED."""
    height, index = _read_place(call.http.query.get("from"), snapshot)
    require_not_pruned(snapshot, height, call.services.peers_with_block)
    contract, name, limit = call.http.query.get("contract"), call.http.query.get("name"), call.int_of("limit")
    head = snapshot.header.height
    found: list[tuple[int, int, ContractEvent]] = []
    scanned, following = 0, (height, index)
    for row in _scan(snapshot, height, index):
        if row is None:
            yield
            continue
        at, number, event = row
        if len(found) == limit:
            following = (at, number)
            break
        scanned, following = scanned + 1, (at, number + 1)
        if contract in {None, event.contract} and name in {None, event.name}:
            found.append((at, number, event))
    else:
        if scanned < SCAN_MAX_COUNT:
            following = (height, index) if head < height else (head + 1, 0)
    return EventsPage(
        head=head,
        earliest_height=snapshot.earliest_height,
        next=f"{following[0]}:{following[1]}",
        events=(yield from _items(snapshot, found)),
    )


def _items(snapshot: LedgerView, found: list[tuple[int, int, ContractEvent]]) -> Steps[list[EventItem]]:
    txids: dict[int, list[str]] = {}
    for height in sorted({at for at, _, _ in found}):
        txids[height] = [one.txid.hex() for one in snapshot.receipts(height) or () for _ in one.events]
        yield
    return [
        EventItem(
            place=f"{at}:{number}",
            contract=event.contract,
            name=event.name,
            data=event.data.hex(),
            txid=txids[at][number],
        )
        for at, number, event in found
    ]


async def _get_page(call: Call) -> web.StreamResponse:
    wait_ms, ledger = call.int_of("wait_ms"), call.services.ledger
    page = await call.read(lambda snapshot: _read_page(call, snapshot))
    if wait_ms and not page.events and int(page.next.partition(":")[0]) > page.head:
        with call.hold_back() as allowed:
            came = allowed and await ledger.wait_above(page.head, wait_ms)
        if came:
            page = await call.read(lambda snapshot: _read_page(call, snapshot))
    return json_answer(page)


ROUTES = (
    Route(
        "GET",
        "/v1/events/page",
        "listEvents",
        "Contract events of finalized blocks from a place on, in order; `next` of the answer is the place to go on from. "
        "With `wait_ms` an answer without events is held back until there is a new block, unless too many are.",
        MEMBER,
        _get_page,
        Answer(JSON, EventsPage, "A page of events."),
        parameters=(
            Parameter("from", "query", "height:index, the first place to read.", pattern=PLACE_PATTERN),
            Parameter("limit", "query", "How many at most.", None, 1, PAGE_MAX_COUNT, 50),
            Parameter("contract", "query", "Only events of this contract.", pattern="^[a-z][a-z0-9_-]{0,31}$"),
            Parameter("name", "query", "Only events of this name.", pattern="^[A-Za-z][A-Za-z0-9_.-]{0,63}$"),
            Parameter("wait_ms", "query", "How long to wait for a new block, in ms.", maximum=WAIT_MAX_MS, default=0),
        ),
        errors=("BLOCK_PRUNED",),
    ),
)

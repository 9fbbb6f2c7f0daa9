"""GET /v1/events: contract events of finalized blocks as they come. Must never lose or repeat one behind a cursor.

Server-sent events; each id is `height:index`, and a stream that starts at a cursor begins with the event after it.
"""

from __future__ import annotations

import json

from aiohttp import web

from consensus.errors import BlockRobotError
from node.api.access import MEMBER
from node.api.pruned import require_kept
from node.api.routing import SSE, Answer, Call, Parameter, Route
from node.api.services import LedgerSnapshot

KEEP_ALIVE_MS = 10_000
BLOCKS_PER_TURN_COUNT = 64


def _read_cursor(call: Call, head: int) -> tuple[int, int]:
    """Return the place after which the stream begins. Without a cursor that is the newest finalized block's end."""
    text = call.http.headers.get("Last-Event-ID") or call.http.query.get("cursor")
    if text is None:
        return head + 1, -1
    height, _, index = text.partition(":")
    if not (height.isascii() and height.isdigit() and index.isascii() and index.isdigit() and len(text) <= 24):
        raise BlockRobotError("REQUEST_INVALID", "The cursor has the form height:index.")
    return int(height), int(index)


def _events_of(call: Call, snapshot: LedgerSnapshot, height: int, after: int) -> list[bytes]:
    require_kept(snapshot, height, call.services.keepers)
    receipts = snapshot.receipts(height)
    if receipts is None:
        raise BlockRobotError("NOT_FOUND", f"Block {height} is no longer kept here.")
    pairs = [(receipt.txid, event) for receipt in receipts for event in receipt.events]
    messages = []
    for index, (txid, event) in enumerate(pairs):
        if index <= after:
            continue
        data = {"contract": event.contract, "name": event.name, "data": event.data.hex(), "txid": txid.hex()}
        messages.append(f"id: {height}:{index}\ndata: {json.dumps(data)}\n\n".encode())
    return messages


async def _stream(call: Call) -> web.StreamResponse:
    with call.hold_back() as allowed:
        if not allowed:
            raise BlockRobotError("RATE_LIMITED", "Too many streams of events are open.")
        return await _send_events(call)


async def _send_events(call: Call) -> web.StreamResponse:
    ledger, expires_at_ms = call.services.ledger, call.session.expires_at_ms if call.session else 0
    with ledger.snapshot() as snapshot:
        height, after = _read_cursor(call, snapshot.header.height)
        require_kept(snapshot, height, call.services.keepers)
    response = web.StreamResponse(headers={"Content-Type": SSE, "Cache-Control": "no-store"})
    await response.prepare(call.http)
    while call.services.clock.now_ms() < expires_at_ms:
        with ledger.snapshot() as snapshot:
            last = min(snapshot.header.height, height + BLOCKS_PER_TURN_COUNT - 1)
            messages: list[bytes] = []
            while height <= last:
                messages += _events_of(call, snapshot, height, after)
                height, after = height + 1, -1
            behind = last < snapshot.header.height
        if messages:
            await response.write(b"".join(messages))
        if not behind and not await ledger.wait_above(height - 1, KEEP_ALIVE_MS):
            await response.write(b": still here\n\n")
    return response


ROUTES = (
    Route(
        "GET",
        "/v1/events",
        "streamEvents",
        "Contract events of finalized blocks as server-sent events, until the session ends. `cursor=H:I` or the header "
        "Last-Event-ID continues after that event.",
        MEMBER,
        _stream,
        Answer(SSE, None, "The stream."),
        parameters=(Parameter("cursor", "query", "height:index of the last event seen.", pattern="^[0-9]+:[0-9]+$"),),
        errors=("BLOCK_PRUNED",),
    ),
)

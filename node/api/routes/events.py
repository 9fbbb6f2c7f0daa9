"""GET /v1/events: finalized contract events as server-sent events, ids `height:index`."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import partial

from aiohttp import web

from consensus.errors import BlockRobotError
from node.api.access.metering import Steps
from node.api.access.route_access import MEMBER
from node.api.routing import SSE, Answer, Call, Parameter, Route
from node.limits.work_costs import bytes_cost_us
from node.storage.ledger_view import LedgerView, PeersWithBlock, require_not_pruned

KEEP_ALIVE_MS = 10_000
BLOCKS_PER_PART_COUNT = 64
PART_MAX_BYTES = 256 * 1024
EVENTS_AT_ONCE_COUNT = 64


def _read_cursor(call: Call, head: int) -> tuple[int, int]:
    text = call.http.headers.get("Last-Event-ID") or call.http.query.get("cursor")
    if text is None:
        return head + 1, -1
    height, _, index = text.partition(":")
    if not (height.isascii() and height.isdigit() and index.isascii() and index.isdigit() and len(text) <= 24):
        raise BlockRobotError("REQUEST_INVALID", "The cursor has the form height:index.")
    return int(height), int(index)


@dataclass(frozen=True, slots=True)
class _Part:
    content: bytes
    height: int
    after: int
    is_behind: bool


def _read_part(snapshot: LedgerView, peers_with_block: PeersWithBlock, height: int, after: int) -> Steps[_Part]:
    """Raises BLOCK_PRUNED and NOT_FOUND."""
    head, size = snapshot.header.height, 0
    messages: list[bytes] = []
    last = min(head, height + BLOCKS_PER_PART_COUNT - 1)
    while height <= last and size < PART_MAX_BYTES:
        require_not_pruned(snapshot, height, peers_with_block)
        receipts = snapshot.receipts(height)
        if receipts is None:
            raise BlockRobotError("NOT_FOUND", f"Block {height} is no longer kept here.")
        yield
        pairs = [(receipt.txid.hex(), event) for receipt in receipts for event in receipt.events]
        for index, (txid, event) in enumerate(pairs[after + 1 :], start=after + 1):
            data = {"contract": event.contract, "name": event.name, "data": event.data.hex(), "txid": txid}
            messages.append(f"id: {height}:{index}\ndata: {json.dumps(data)}\n\n".encode())
            size += len(messages[-1])
            if index % EVENTS_AT_ONCE_COUNT == 0:
                yield
        height, after = height + 1, -1
    return _Part(b"".join(messages), height, after, height <= head)


async def _stream(call: Call) -> web.StreamResponse:
    with call.hold_back() as allowed:
        if not allowed:
            raise BlockRobotError("RATE_LIMITED", "Too many streams of events are open.")
        return await _send_events(call)


async def _send_events(call: Call) -> web.StreamResponse:
    ledger, peers_with_block = call.services.ledger, call.services.peers_with_block
    with ledger.snapshot() as snapshot:
        height, after = _read_cursor(call, snapshot.header.height)
        require_not_pruned(snapshot, height, peers_with_block)
    response = web.StreamResponse(headers={"Content-Type": SSE, "Cache-Control": "no-store"})
    await response.prepare(call.http)
    while call.is_allowed_still():
        await call.meter.pace()
        part = await call.read(partial(_read_part, peers_with_block=peers_with_block, height=height, after=after))
        height, after = part.height, part.after
        if part.content:
            await response.write(part.content)
            call.meter.add(bytes_cost_us(len(part.content)))
        if not part.is_behind and not await ledger.wait_above(height - 1, KEEP_ALIVE_MS):
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

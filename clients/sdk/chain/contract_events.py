"""Read contract events in order from a place (height:index). Pages are unproved; receipts prove events."""

from __future__ import annotations

from collections.abc import AsyncIterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from clients.sdk.connections import NodeAddress
from clients.sdk.network_client import FROZEN_AFTER_MS, NetworkClient
from clients.sdk.node_answers import read_answer, read_hex
from consensus.api_documents import PAGE_MAX_COUNT, EventsPage
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode_value
from consensus.primitives.keys import PrivateKey

PAGES_MAX_COUNT = 10_000  # each of 100 events that were found, or of 1,000 that were looked at


@dataclass(frozen=True, slots=True, order=True)
class Place:
    """Block height, and index among the block's events."""

    height: int
    index: int

    def __str__(self) -> str:
        return f"{self.height}:{self.index}"


@dataclass(frozen=True, slots=True)
class FoundEvent:
    """A decoded event with place and transaction."""

    place: Place
    contract: str
    name: str
    data: Any
    txid: bytes


@dataclass(frozen=True, slots=True)
class EventPage:
    """Ordered events and the next place; `head` is the node's newest block."""

    events: tuple[FoundEvent, ...]
    next: Place
    head: int


def read_place(text: str) -> Place:
    """Raises VALUE_INVALID."""
    height, _, index = text.partition(":")
    if not (text.isascii() and height.isdigit() and index.isdigit() and len(height) <= 15 and len(index) <= 9):
        raise BlockRobotError("VALUE_INVALID", f"{text[:40]!r} is no place of events: it has the form height:index.")
    return Place(int(height), int(index))


def _read_page(content: bytes, first: Place | None) -> EventPage:
    """Raise ENCODING_INVALID if out of order, to try another node."""
    answer = read_answer(content, EventsPage)
    found = tuple(
        FoundEvent(
            place=read_place(event.place),
            contract=event.contract,
            name=event.name,
            data=decode_value(read_hex(event.data)),
            txid=read_hex(event.txid),
        )
        for event in answer.events
    )
    following = read_place(answer.next)
    places = [event.place for event in found]
    if first is not None:
        places = [Place(first.height, first.index - 1), *places]
    places.append(following)
    if any(one >= other for one, other in pairwise(places)):
        raise BlockRobotError("ENCODING_INVALID", "The node's events are not in order.")
    return EventPage(found, following, answer.head)


async def read_events(
    client: NetworkClient,
    key: PrivateKey,
    first: Place | None,
    *,
    contract: str | None = None,
    name: str | None = None,
    limit: int = PAGE_MAX_COUNT,
    wait_ms: int = 0,
    reached: int = 0,
) -> EventPage:
    """Return events from `first` (None: oldest kept), long-polling up to `wait_ms`, of a node that has block `reached`.

    Raises BLOCK_PRUNED.
    """
    query: dict[str, str | int] = {"limit": limit, "wait_ms": wait_ms}
    chosen = {"from": None if first is None else str(first), "contract": contract, "name": name}
    query.update({field: value for field, value in chosen.items() if value is not None})

    async def ask(node: NodeAddress) -> EventPage:
        content = await client.ask_node(
            node, "GET", "/v1/events/page", key=key, query=query, timeout_ms=wait_ms + FROZEN_AFTER_MS
        )
        page = _read_page(content, first)
        if page.head < reached:
            raise BlockRobotError("NODE_NOT_READY", f"The node has blocks up to {page.head} only.")
        return page

    await client.find_nodes(key)
    return await client.with_any_node(ask)


async def each_event(
    client: NetworkClient, key: PrivateKey, *, contract: str, name: str | None = None
) -> AsyncIterator[FoundEvent]:
    """All events that nodes keep, oldest first, to the block that is newest at the start. A page may be empty long before.

    Raises as `read_events`, and EVENTS_TOO_MANY.
    """
    place, last = None, None
    for _ in range(PAGES_MAX_COUNT):
        reached = 0 if place is None else place.height
        page = await read_events(client, key, place, contract=contract, name=name, reached=reached)
        for event in page.events:
            yield event
        last = page.head if last is None else last
        if page.next.height > last:
            return
        place = page.next
    raise BlockRobotError("EVENTS_TOO_MANY")

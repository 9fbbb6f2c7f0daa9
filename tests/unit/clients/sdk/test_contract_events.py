"""Events as a client reads them: in order, each once, from whichever node has them."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest

from clients.sdk.chain import contract_events
from clients.sdk.chain.contract_events import (
    PAGES_MAX_COUNT,
    EventPage,
    FoundEvent,
    Place,
    _read_page,
    each_event,
    read_events,
    read_place,
)
from clients.sdk.network_client import NetworkClient
from consensus.chain.block import ContractEvent, Receipt
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode_value
from node.api.routes.event_pages import SCAN_MAX_COUNT
from node.snapshot.making import header_of_block
from tests.unit.clients.sdk.conftest import TwoNodes
from tests.unit.node.api.small_network import SUBJECT, SmallLedger
from tests.unit.node.explorer.test_explorer_routes import a_call


@pytest.fixture
async def two_nodes() -> AsyncIterator[TwoNodes]:
    """Two nodes of one network, each on what a test gives it."""
    network = TwoNodes()
    yield network
    await network.close()


async def ledger_with_events(blocks: int) -> SmallLedger:
    ledger = await SmallLedger().start()
    for number in range(blocks):
        event = ContractEvent(contract="notes", name="written", data=encode_value({"n": number}))
        receipt = Receipt(bytes([number]) * 32, ok=True, code="OK", message="", line=None, gas_used=1, events=(event,))
        await ledger.extend(receipts=(receipt,))
    return ledger


async def test_a_reader_goes_on_at_another_node(two_nodes: TwoNodes) -> None:
    ledger = await ledger_with_events(5)
    for name in ("n0", "n1"):
        await two_nodes.add(name, ledger)
    client: NetworkClient = two_nodes.client()
    first = await read_events(client, SUBJECT, None, limit=2)
    assert [event.data for event in first.events] == [{"n": 0}, {"n": 1}]
    await two_nodes.running["n0"].server.close()
    rest = await read_events(client, SUBJECT, first.next)
    assert [event.data for event in rest.events] == [{"n": 2}, {"n": 3}, {"n": 4}]
    assert (rest.next, rest.head, rest.events[0].txid) == (Place(6, 0), 5, bytes([2]) * 32)


async def test_what_one_node_pruned_is_asked_of_the_others(two_nodes: TwoNodes) -> None:
    pruned, whole = await ledger_with_events(5), await ledger_with_events(5)
    await pruned.store.prune(4, header_of_block)
    await two_nodes.add("n0", pruned)
    await two_nodes.add("n1", whole)
    client: NetworkClient = two_nodes.client()
    page = await read_events(client, SUBJECT, Place(2, 0))
    assert len(page.events) == 4
    await whole.store.prune(4, header_of_block)
    with pytest.raises(BlockRobotError, match=r"^BLOCK_PRUNED:"):
        await read_events(client, SUBJECT, Place(2, 0))


async def test_events_of_other_contracts_hide_none_that_come_later(two_nodes: TwoNodes) -> None:
    """A node looks at so many events for one page; a wallet must not take an empty one for the end."""
    ledger = await SmallLedger().start()
    wanted = ContractEvent(contract="notes", name="written", data=encode_value({}))
    other = ContractEvent(contract="custody", name="stored", data=encode_value({}))
    sequences = [(wanted,), (other,) * (SCAN_MAX_COUNT + 200), (other,) * SCAN_MAX_COUNT, (wanted,), ()]
    for number, events in enumerate(sequences):
        await ledger.extend(receipts=(Receipt(bytes([number]) * 32, True, "OK", "", None, 1, events),))
    await two_nodes.add("n0", ledger)
    found = [event.place.height async for event in each_event(two_nodes.client(), SUBJECT, contract="notes")]
    assert found == [1, 4]


async def test_a_node_whose_pages_have_no_end_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = 0

    async def invent(_: NetworkClient, __: object, first: Place | None, **___: object) -> EventPage:
        nonlocal asked
        asked += 1
        place = Place((first or Place(0, 0)).height + 1, 0)
        return EventPage((FoundEvent(place, "notes", "written", {}, bytes(32)),), Place(place.height, 1), 10**9)

    monkeypatch.setattr(contract_events, "read_events", invent)
    with pytest.raises(BlockRobotError, match=r"^EVENTS_TOO_MANY:"):
        async for _ in each_event(None, SUBJECT, contract="notes"):  # type: ignore[arg-type]
            pass
    assert asked == PAGES_MAX_COUNT


async def test_a_node_that_is_behind_does_not_end_what_another_began(two_nodes: TwoNodes) -> None:
    other = ContractEvent(contract="custody", name="stored", data=encode_value({}))
    wanted = ContractEvent(contract="notes", name="written", data=encode_value({}))
    ahead, behind = await SmallLedger().start(), await SmallLedger().start()
    for number, events in enumerate([(other,) * SCAN_MAX_COUNT, (other,) * SCAN_MAX_COUNT, (wanted,)]):
        receipt = Receipt(bytes([number]) * 32, True, "OK", "", None, 1, events)
        await ahead.extend(receipts=(receipt,))
        if number == 0:
            await behind.extend(receipts=(receipt,))
    await two_nodes.add("n0", behind)
    await two_nodes.add("n1", ahead)
    client = two_nodes.client()
    page = await read_events(client, SUBJECT, Place(1, SCAN_MAX_COUNT), contract="notes", reached=2)
    assert page.head == 3
    with pytest.raises(BlockRobotError):
        await read_events(client, SUBJECT, Place(1, SCAN_MAX_COUNT), contract="notes", reached=4)


def answer(*places: str, following: str) -> bytes:
    event = f'"contract":"c","name":"n","data":"80","txid":"{"00" * 32}"'
    items = ",".join(f'{{"place":"{place}",{event}}}' for place in places)
    return f'{{"head":9,"earliest_height":0,"next":"{following}","events":[{items}]}}'.encode()


@pytest.mark.parametrize(
    ("places", "following"),
    [(["4:0"], "6:0"), (["5:1", "5:1"], "6:0"), (["5:2", "5:1"], "6:0"), (["5:1"], "5:1"), ([], "4:9")],
)
def test_a_node_that_goes_back_or_repeats_is_not_believed(places: list[str], following: str) -> None:
    with pytest.raises(BlockRobotError, match=r"^ENCODING_INVALID:"):
        _read_page(answer(*places, following=following), Place(5, 0))


def test_a_node_that_has_nothing_leaves_the_reader_where_it_is() -> None:
    assert _read_page(answer(following="5:0"), Place(5, 0)).next == Place(5, 0)
    assert _read_page(answer("5:0", following="5:1"), Place(5, 0)).next == Place(5, 1)


def test_a_place_is_two_numbers() -> None:
    assert str(read_place("12:3")) == "12:3"
    for wrong in ("", "12", "a:b", "1:-1", "1:2:3", "１:2"):
        with pytest.raises(BlockRobotError):
            read_place(wrong)


async def test_an_old_receipt_comes_from_the_node_that_keeps_it_and_is_not_waited_for_where_none_does(
    two_nodes: TwoNodes,
) -> None:
    call, receipt = a_call()
    ledgers = [await SmallLedger().start() for _ in range(2)]
    for ledger in ledgers:
        await ledger.extend([call], (receipt,))
        for _ in range(3):
            await ledger.extend()
    await ledgers[0].store.prune(3, header_of_block)
    for name, ledger in zip(("n0", "n1"), ledgers, strict=True):
        await two_nodes.add(name, ledger)
    client: NetworkClient = two_nodes.client()
    assert (await client.wait_final(call.txid)).height == 1
    await ledgers[1].store.prune(3, header_of_block)
    with pytest.raises(BlockRobotError, match=r"^BLOCK_PRUNED:"):
        await client.wait_final(call.txid)

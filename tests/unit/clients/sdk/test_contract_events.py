"""Events as a client reads them: in order, each once, from whichever node has them."""

from __future__ import annotations

from collections.abc import AsyncIterator

import pytest

from clients.sdk.chain.contract_events import Place, _read_page, read_events, read_place
from clients.sdk.network_client import NetworkClient
from consensus.chain.block import ContractEvent, Receipt
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode_value
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

"""Clients learn from the proved state which nodes there are: genesis is only where they begin."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any, Literal

import msgspec
import pytest

from clients.sdk.known_nodes import REFRESH_MS, RETRY_MS, KnownCustodian, KnownNode, KnownNodes, nodes_of_genesis
from clients.sdk.network_client import NetworkClient
from clients.sdk.trust_pin import open_pin, write_pin
from consensus.chain.light_client import LightClient
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode_value
from consensus.primitives.hashing import sha256
from consensus.records.placement import Placement
from consensus.state import records
from consensus.state.identity import ROOM, RoomRow
from consensus.state.membership import NODE, NODES, ORGANISATION, NodeRow, OrganisationRow
from consensus.state.settings import CUSTODY_COPIES, QUOTA
from node.api.routes import proofs
from tests.unit.clients.sdk.conftest import DEAD_URL
from tests.unit.node.api.small_network import CUSTODIAN, STRANGER, SUBJECT, ManualClock, flat

ACTIVE = ("n0", "n1", "n2")


def entry(name: str, url: str, *, status: Literal["active", "removed"] = "active", custodian: bool = False) -> NodeRow:
    key = CUSTODIAN.public_key if custodian else b""
    return NodeRow(name, "ward", "127.0.0.1", 1, url, b"", b"", key, status, 1)


class Town:
    """Nodes n0 and n1 stood at the beginning; n2 has joined since. What the chain says of them is written with `say`."""

    def __init__(self, nodes: Any) -> None:
        self.nodes = nodes
        self.ledger = nodes["n0"].node.ledger
        self.addresses: dict[str, str] = dict(nodes.urls)
        self.clock = ManualClock()

    async def say(self, active: Iterable[str], **addresses: str) -> None:
        """Let the state name these nodes; n2 is a custodian, n0 is none any more."""
        names = list(active)
        urls = self.addresses | addresses
        values = {NODES.flat: NODES.encode(sorted(names))}
        for name in urls:
            status: Literal["active", "removed"] = "active" if name in names else "removed"
            values[NODE.key(name)] = NODE.encode(entry(name, urls[name], status=status, custodian=name == "n2"))
        values[ORGANISATION.key("ward")] = ORGANISATION.encode(OrganisationRow("ward", "THE AUTHORITY", "active", 0))
        await self.ledger.extend(writes=values)

    def pin(self, **urls: str) -> bytes:
        """What a client keeps that knows these addresses from the beginning."""
        known = tuple(KnownNode(name, url, "") for name, url in urls.items())
        return write_pin(LightClient(self.ledger.genesis), KnownNodes(0, known, (), 0))

    def client(self, pinned: bytes | None = None) -> NetworkClient:
        first = {name: url for name, url in self.addresses.items() if name in ("n0", "n1")}
        pin = self.pin(**first) if pinned is None else pinned
        client = NetworkClient(self.ledger.genesis, pinned=pin, clock=self.clock)
        self.nodes.clients.append(client)
        return client

    def looks(self) -> int:
        """How often anybody asked the nodes for proofs."""
        running = self.nodes.running.values()
        return sum([seen.path for seen in node.seen].count("/v1/state-proofs") for node in running)


@pytest.fixture
async def town(nodes: Any) -> Town:
    await nodes.add("n2", nodes["n0"].node.ledger)
    return Town(nodes)


def names_of(client: NetworkClient) -> list[str]:
    return [node.name for node in client.nodes]


async def test_a_node_that_came_later_is_found_and_helps_when_the_first_ones_are_gone(town: Town) -> None:
    await town.say(ACTIVE)
    client = town.client()
    assert names_of(client) == ["n0", "n1"]
    await client.newest_header(SUBJECT)
    assert names_of(client) == ["n0", "n1", "n2"]
    for name in ("n0", "n1"):
        await town.nodes[name].server.close()
    assert await client.query("echo", "back", [1], SUBJECT) == [1]


async def test_a_removed_node_is_asked_no_more(town: Town) -> None:
    await town.say(["n1", "n2"])
    client = town.client()
    await client.newest_header(SUBJECT)
    assert names_of(client) == ["n1", "n2"]
    seen = len(town.nodes["n0"].seen)
    assert await client.state_value(records.ANNOUNCEMENT_COUNT.flat, SUBJECT) == 3
    assert await client.query("echo", "back", [1], SUBJECT) == [1]
    assert len(town.nodes["n0"].seen) == seen


async def test_what_was_learned_is_kept_with_the_pin_though_no_first_node_is_left(town: Town) -> None:
    await town.say(["n2"])
    client = town.client()
    await client.catch_up(SUBJECT)
    for name in ("n0", "n1"):
        await town.nodes[name].server.close()
    later = town.client(client.pinned)
    assert names_of(later) == ["n2"]
    assert (await later.newest_header(SUBJECT)).height == 1
    _, known = open_pin(town.ledger.genesis, later.pinned)
    assert known is not None
    assert (known.height, known.names) == (1, ("n2",))


async def test_custodians_are_those_that_the_state_names(town: Town) -> None:
    await town.say(ACTIVE)
    client = town.client()
    await client.find_nodes(SUBJECT)
    assert [node.name for node in client.custody.custodians] == ["n2"]
    joined = KnownCustodian("n2", "ward", CUSTODIAN.public_key)
    founding = nodes_of_genesis(town.ledger.genesis).custodians
    assert client.known_custodians == (*founding, joined)
    assert town.client(client.pinned).known_custodians == (*founding, joined)


async def test_a_client_that_only_submits_may_look_by_itself(town: Town) -> None:
    await town.say(ACTIVE)
    client = town.client()
    await client.find_nodes(SUBJECT)
    assert names_of(client) == list(ACTIVE)
    await client.find_nodes(SUBJECT)
    assert town.looks() == 2 * 3, "twice: once more after something was new, and not again within the minute"


async def test_it_looks_again_after_a_minute_and_when_the_producers_change(town: Town) -> None:
    await town.say(("n0", "n1"))
    client = town.client()
    await client.newest_header(SUBJECT)
    await town.say(ACTIVE)
    await client.newest_header(SUBJECT)
    assert names_of(client) == ["n0", "n1"]
    town.clock.time_ms += REFRESH_MS
    await client.newest_header(SUBJECT)
    assert names_of(client) == list(ACTIVE)

    await town.say(("n1", "n2"))
    await town.ledger.change_epoch()
    await town.ledger.extend()
    await client.newest_header(SUBJECT)
    await client.newest_header(SUBJECT)
    assert names_of(client) == ["n1", "n2"]


async def test_it_looks_again_when_a_node_does_not_answer(town: Town) -> None:
    await town.say(("n0", "n1"))
    client = town.client()
    await client.newest_header(SUBJECT)
    await town.say(("n1", "n2"))
    await town.nodes["n0"].server.close()
    await client.newest_header(SUBJECT)
    town.clock.time_ms += RETRY_MS
    await client.newest_header(SUBJECT)
    assert names_of(client) == ["n1", "n2"]


async def test_a_lie_about_the_nodes_is_not_believed(town: Town, monkeypatch: pytest.MonkeyPatch) -> None:
    honest = proofs.prove_keys

    def lie(snapshot: Any, keys: Any) -> Any:
        found = yield from honest(snapshot, keys)
        named = [row for row in found if row.key == flat("membership", b"nodes").hex()]
        return [replace(row, value=encode_value(["n2"]).hex()) if row in named else row for row in found]

    await town.say(("n0", "n1"))
    monkeypatch.setattr(proofs, "prove_keys", lie)
    client = town.client()
    await client.find_nodes(SUBJECT)
    assert names_of(client) == ["n0", "n1"]
    monkeypatch.setattr(proofs, "prove_keys", honest)
    town.clock.time_ms += REFRESH_MS
    await client.find_nodes(SUBJECT)
    assert names_of(client) == ["n0", "n1"]


@pytest.mark.parametrize("url", ["http://192.0.2.1:80", "ftp://127.0.0.1", "http://[", "nowhere"])
async def test_an_address_that_no_client_may_use_is_left_out(town: Town, url: str) -> None:
    await town.say(ACTIVE, n1=url)
    client = town.client()
    await client.find_nodes(SUBJECT)
    assert names_of(client) == ["n0", "n2"]


async def test_if_no_address_can_be_used_the_known_ones_are(town: Town) -> None:
    await town.say(("n1",), n1="http://192.0.2.1:80")
    client = town.client()
    await client.find_nodes(SUBJECT)
    assert names_of(client) == ["n0", "n1"]


async def test_for_https_the_organisations_authority_comes_from_the_state_too(town: Town) -> None:
    await town.say(ACTIVE, n2="https://node.example:1")
    client = town.client()
    await client.find_nodes(SUBJECT)
    (found,) = [node for node in client.nodes if node.name == "n2"]
    assert (found.url, found.ca_certificate) == ("https://node.example:1", "THE AUTHORITY")
    with pytest.raises(BlockRobotError) as refusal:
        await client.ask_node(found, "GET", "/v1/genesis")
    assert refusal.value.code == "NODE_UNREACHABLE", "this is no certificate, so there is nothing to trust"


async def test_a_stranger_learns_nothing_and_breaks_nothing(town: Town) -> None:
    await town.say(ACTIVE)
    client = town.client()
    await client.find_nodes(STRANGER)
    assert names_of(client) == ["n0", "n1"]


async def test_a_chain_that_says_nothing_of_its_nodes_keeps_the_first_ones(town: Town) -> None:
    client = town.client()
    await client.newest_header(SUBJECT)
    assert names_of(client) == ["n0", "n1"]


async def test_a_client_that_was_told_whom_to_ask_asks_nobody_else(town: Town) -> None:
    await town.say(ACTIVE)
    client = town.nodes.client(urls={"n1": town.addresses["n1"]})
    await client.newest_header(SUBJECT)
    assert names_of(client) == ["n1"]
    assert town.looks() == 0


async def test_nodes_that_came_later_may_be_named_once_a_pin_knows_them(town: Town) -> None:
    await town.say(ACTIVE)
    client = town.client()
    await client.find_nodes(SUBJECT)
    genesis, only = town.ledger.genesis, {"n4": DEAD_URL}
    with pytest.raises(BlockRobotError, match=r"^CONFIGURATION_INVALID:"):
        NetworkClient(genesis, only, pinned=client.pinned)
    await town.say((*ACTIVE, "n4"), n4=DEAD_URL)
    town.clock.time_ms += REFRESH_MS
    await client.find_nodes(SUBJECT)
    async with NetworkClient(genesis, only, pinned=client.pinned) as one:
        assert names_of(one) == ["n4"]


async def test_a_client_begins_with_the_node_it_was_told_to(town: Town) -> None:
    await town.say(ACTIVE)
    genesis = town.ledger.genesis
    pinned = town.pin(**town.addresses)
    async with NetworkClient(genesis, pinned=pinned, first="n1", clock=ManualClock()) as client:
        await client.query("echo", "back", [1], SUBJECT)
    assert [len(town.nodes[name].seen) > 0 for name in ACTIVE] == [False, True, False]


def test_the_beginning_is_the_genesis_file(nodes: Any) -> None:
    known = nodes_of_genesis(nodes["n0"].node.ledger.genesis)
    assert (known.height, known.names) == (0, ("n0", "n1", "n2", "n3"))
    assert [each.name for each in known.custodians] == [known.nodes[0].name]


async def test_who_keeps_a_clip_follows_from_the_proved_members_and_setting(town: Town) -> None:
    everybody = (*ACTIVE, "unreachable")
    await town.say(everybody, unreachable="http://10.0.0.9:7273")
    keys = {name: b"\x02" + sha256(name.encode()) for name in everybody}
    rows = {NODE.key(name): NODE.encode(replaced_key(town, name, key)) for name, key in keys.items()}
    rooms = dict(zip(keys.values(), (1_000, 0, 4_000, 1), strict=True))
    said = {ROOM.key(key): ROOM.encode(RoomRow(gib, 0)) for key, gib in rooms.items() if gib}
    await town.ledger.extend(writes=rows | said | {QUOTA.key(CUSTODY_COPIES): encode_value(2)})
    client = town.client()
    await client.find_nodes(SUBJECT)
    for number in range(9):
        record_id = sha256(b"%d" % number)[:16]
        placement = Placement.of(rooms, 2, dict.fromkeys(rooms, "ward"))
        ranked = [key for key in placement.rank(record_id) if key != keys["unreachable"]]
        keepers, others = client.custody.rank(record_id)
        assert [keys[node.name] for node in (*keepers, *others)] == ranked
        assert len(keepers) == 2
    later = town.client(client.pinned)
    assert later.custody.rank(record_id) == (keepers, others)


async def test_a_clip_is_sent_to_two_organisations(town: Town) -> None:
    await town.say(ACTIVE)
    keys = {name: b"\x02" + sha256(name.encode()) for name in ACTIVE}
    owners = dict(zip(ACTIVE, ("ward", "ward", "clinic"), strict=True))
    rows = {NODE.key(name): NODE.encode(replaced_key(town, name, key, owners[name])) for name, key in keys.items()}
    await town.ledger.extend(writes=rows | {QUOTA.key(CUSTODY_COPIES): encode_value(2)})
    client = town.client()
    await client.find_nodes(SUBJECT)
    for number in range(9):
        keepers, _ = client.custody.rank(sha256(b"%d" % number)[:16])
        assert {owners[node.name] for node in keepers} == {"ward", "clinic"}


def replaced_key(town: Town, name: str, key: bytes, organisation: str = "ward") -> NodeRow:
    row = entry(name, town.addresses.get(name, "http://10.0.0.9:7273"))
    return msgspec.structs.replace(row, custodian_key=key, organisation=organisation)

"""What several nodes say together: a quorum of producers that knows of nothing newer, and nodes that turn a key away."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, Literal

import pytest

from clients.sdk.connections import NodeAddress
from clients.sdk.proof_checks import ProvedState
from clients.sdk.quorum import confirm_with_quorum, is_rejected_by_network
from consensus.chain.epoch_settings import ChainSettings, Epoch
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from consensus.state.keys import to_value
from consensus.state.membership import NODE, NODES, NodeRow
from tests.unit.node.api.small_network import SUBJECT

KEYS = [PrivateKey(bytes([number]) * 32).public_key for number in range(1, 6)]


class Nodes:
    """Nodes n0 to n4, the first four of them producers; each answers, or fails with a code."""

    def __init__(self, *codes: str) -> None:
        self.codes = {f"n{number}": code for number, code in enumerate(codes)}
        self.nodes = tuple(NodeAddress(name, f"http://127.0.0.1/{name}") for name in self.codes)
        self.light_client = SimpleNamespace(epoch=Epoch(0, tuple(KEYS[:4]), (), ChainSettings()))
        entries = [
            SimpleNamespace(name=f"n{number}", producer_key=key if number < 4 else b"")
            for number, key in enumerate(KEYS)
        ]
        self.genesis = SimpleNamespace(nodes=entries)
        self.state: dict[bytes, Any] = {}
        self.on_ask = lambda: None

    async def node_header(self, node: NodeAddress, key: PrivateKey) -> None:
        self.on_ask()
        if self.codes[node.name]:
            raise BlockRobotError(self.codes[node.name])

    async def state_values(self, keys: list[bytes], key: PrivateKey) -> ProvedState:
        return ProvedState(1, 1, {flat: self.state.get(flat) for flat in keys})


AWAY, BEHIND, REFUSED = "NODE_UNREACHABLE", "PROOF_STALE", "SESSION_REFUSED"


@pytest.mark.parametrize(
    ("codes", "expected"),
    [
        (("", "", "", "", ""), True),
        (("", AWAY, "", "", AWAY), True),
        (("", "", BEHIND, "", ""), True),
        (("", "", AWAY, BEHIND, ""), False),  # n4 is no producer
        (("", AWAY, AWAY, AWAY, AWAY), False),
        (("", "", ""), True),
        (("", ""), False),
    ],
)
async def test_three_of_four_producers_are_a_quorum(codes: tuple[str, ...], expected: bool) -> None:
    assert await confirm_with_quorum(Nodes(*codes), SUBJECT) is expected  # type: ignore[arg-type]


def put_node(nodes: Nodes, number: int, key: bytes, status: Literal["active", "removed"]) -> None:
    row = NodeRow(f"n{number}", "ward", "127.0.0.1", 1, "http://127.0.0.1:2", key, b"", b"", status, 1)
    nodes.state[NODE.key(row.name)] = to_value(row)


async def test_who_produces_is_told_by_the_state_and_counts_once() -> None:
    nodes = Nodes("", "", "", "", "")
    nodes.state[NODES.flat] = ["n0", "n1", "n2", "n3"]
    for number, seat in enumerate((0, 0, 1, 2)):
        put_node(nodes, number, KEYS[seat], "active" if number < 3 else "removed")
    assert await confirm_with_quorum(nodes, SUBJECT) is False  # type: ignore[arg-type]
    put_node(nodes, 3, KEYS[2], "active")
    assert await confirm_with_quorum(nodes, SUBJECT) is True  # type: ignore[arg-type]


async def test_an_epoch_that_begins_meanwhile_makes_the_answers_worthless() -> None:
    nodes = Nodes("", "", "", "")

    def enter() -> None:
        nodes.light_client.epoch = Epoch(1, tuple(KEYS[1:]), (), ChainSettings())

    nodes.on_ask = enter
    assert await confirm_with_quorum(nodes, SUBJECT) is False  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("codes", "expected"),
    [
        ((REFUSED, REFUSED, REFUSED, REFUSED), True),
        ((REFUSED, REFUSED, AWAY, AWAY), True),
        ((REFUSED, REFUSED, "NODE_ADDRESS_WRONG", "NODE_REMOVED"), True),
        ((REFUSED, AWAY, AWAY, AWAY), False),
        ((REFUSED, REFUSED, REFUSED, ""), False),
        ((REFUSED, REFUSED, REFUSED, BEHIND), False),
        ((AWAY, AWAY, AWAY, AWAY), False),
    ],
)
async def test_a_key_is_turned_away_when_nobody_serves_it(codes: tuple[str, ...], expected: bool) -> None:
    assert await is_rejected_by_network(Nodes(*codes), SUBJECT) is expected  # type: ignore[arg-type]


async def test_over_real_nodes(nodes: Any) -> None:
    """Of a network of four producers two are a pair that may be cut off; with a third they are a quorum."""
    client = nodes.client()
    assert await client.newest_header(SUBJECT)
    assert await confirm_with_quorum(client, SUBJECT) is False
    await nodes.add("n2", nodes["n0"].node.ledger)
    client = nodes.client()
    assert await confirm_with_quorum(client, SUBJECT) is True
    assert await is_rejected_by_network(client, SUBJECT) is False
    assert await is_rejected_by_network(client, PrivateKey(bytes([77]) * 32)) is True

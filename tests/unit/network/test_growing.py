"""What `node add` says in the organisations' names, in front of a consortium in memory."""

from __future__ import annotations

from typing import cast

import pytest

from clients.sdk.network_client import NetworkClient
from consensus.errors import BlockRobotError
from network.provisioning.node_adding import NodeAddition, Step
from tests.unit.clients.sdk.consortium_client import ConsortiumClient
from tests.unit.contracts.system.consortium import Consortium, admin_of, key_of, node_fields, producer_of

NEWCOMER = "node-05"


def growth_of(chain: Consortium, *names: str) -> tuple[NodeAddition, list[str]]:
    """The voices of these organisations, and what is told of their steps."""
    told: list[str] = []
    client = cast(NetworkClient, ConsortiumClient(chain))
    voices = {name: key_of("not in force") if name == "stranger" else admin_of(name) for name in names}

    def on_progress(step: Step) -> None:
        told.append(step.sentence())

    return NodeAddition(client, voices, on_progress), told


async def agreed(growth: NodeAddition) -> bool:
    return await growth.agree("add_node", node_fields(NEWCOMER, "org-02"), "org-02")


async def test_every_step_to_a_seat_is_told_and_no_voice_is_used_that_is_not_needed() -> None:
    chain = Consortium()
    growth, told = growth_of(chain, "org-01", "org-02", "org-03")
    await growth.begin()
    assert await agreed(growth)
    assert await growth.vote_in(NEWCOMER, producer_of(NEWCOMER).public_key, "org-02")
    chain.ready(NEWCOMER)
    await growth.wait_seated(NEWCOMER, producer_of(NEWCOMER).public_key)
    opened = told[1].split()[3]
    assert told == [
        "org-02: org propose add-node node-05 (final at height 1)",
        f"org-01: org approve {opened} (add-node node-05) (final at height 2)",
        "org-02: producer propose node-05 (final at height 3)",
        "org-01: producer approve node-05 (final at height 4)",
        "node-05 was ready at height 4: it has a seat (final at height 5)",
        "5 producers; they bear 1 that fail",
    ]
    assert growth.waiting_for == []


async def test_where_the_keys_here_make_no_majority_the_others_are_waited_for() -> None:
    chain = Consortium()
    growth, _ = growth_of(chain, "org-02")
    await growth.begin()
    assert not await agreed(growth)
    (command,) = growth.waiting_for
    ((opened, _, _),) = chain.value("membership", b"open")
    assert command.startswith(f"blockrobot org approve {opened.hex()[:12]} --as ORG")
    assert chain.value("membership", b"node/" + NEWCOMER.encode()) is None

    chain.agree("add_node", node_fields("node-06", "org-02"))
    assert not await growth.vote_in("node-06", producer_of("node-06").public_key, "org-02")
    assert growth.waiting_for[1].startswith("blockrobot producer approve node-06 --as ORG")


async def test_an_organisation_without_a_voice_yet_is_left_out() -> None:
    growth, _ = growth_of(Consortium(), "stranger", "org-01")
    await growth.begin()
    assert list(growth.voices) == ["org-01"]
    nobody, _ = growth_of(Consortium(), "stranger")
    with pytest.raises(BlockRobotError, match=r"^GOVERNANCE_NOT_ADMIN:"):
        await nobody.begin()


async def test_a_network_with_nodes_on_other_machines_gets_none_at_this_machines_own_address() -> None:
    chain = Consortium()
    away = {"host": "10.0.0.7", "api_url": "https://10.0.0.7:4101"}
    chain.agree("add_node", node_fields("node-06", "org-02") | away)
    with pytest.raises(BlockRobotError, match=r"^CONFIGURATION_INVALID: node-06 .* node init --bind"):
        await growth_of(chain, "org-01")[0].begin()
    chain.agree("remove_node", {"name": "node-06"})
    await growth_of(chain, "org-01")[0].begin()


async def test_a_candidate_without_a_free_seat_is_told_so_and_one_that_is_silent_fails() -> None:
    chain = Consortium()
    growth, told = growth_of(chain, "org-01", "org-02")
    await growth.begin()
    await agreed(growth)
    key = producer_of(NEWCOMER).public_key
    await growth.vote_in(NEWCOMER, key, "org-01")
    with pytest.raises(BlockRobotError, match=r"^CLUSTER_START_FAILED:"):
        await growth.wait_seated(NEWCOMER, key, timeout_s=0)
    chain.agree_setting("max_producers", 4)
    await growth.wait_seated(NEWCOMER, key)
    assert told[-1] == "node-05 is a candidate; all 4 seats are taken (max_producers)"

"""One organisation speaks, and everybody reads what is decided: from proofs, with the reason for every refusal."""

from __future__ import annotations

from collections.abc import Awaitable
from typing import Any

import pytest

from clients.sdk.chain.governance import Governor, read_membership, read_producers, resolve_proposal, settings_in_force
from consensus.errors import BlockRobotError
from tests.unit.clients.sdk.consortium_client import ConsortiumClient
from tests.unit.contracts.system.consortium import (
    Consortium,
    admin_of,
    key_of,
    node_fields,
    organisation_fields,
    producer_of,
)

READER = admin_of("org-01")


@pytest.fixture
def client() -> Any:
    """Three organisations, four producers."""
    return ConsortiumClient(Consortium())


def governor(client: Any, organisation: str) -> Governor:
    return Governor(client, admin_of(organisation))


async def refusal_of(work: Awaitable[Any]) -> BlockRobotError:
    with pytest.raises(BlockRobotError) as refusal:
        await work
    return refusal.value


async def test_a_proposal_is_read_approved_and_told(client: Any) -> None:
    opened = await governor(client, "org-01").propose("settings", "set", {"name": "heartbeat_ms", "value": 9000})
    assert (opened.executed, opened.epoch, opened.height) == (False, None, 1)
    view = await read_membership(client, READER)
    (row,) = view.proposals
    assert (row.id, row.kind, row.approvals) == (opened.proposal_id, "set", ["org-01"])
    assert view.majority == 2
    found = resolve_proposal(view.proposals, row.id.hex()[:8].upper())
    decided = await governor(client, "org-02").approve(found)
    assert (decided.executed, decided.epoch, decided.height) == (True, 1, 2)
    producers = await read_producers(client, READER)
    assert settings_in_force(producers)["heartbeat_ms"] == 9000
    assert settings_in_force(producers)["max_producers"] == 21
    assert producers.since_height == 2
    assert (await read_membership(client, READER)).proposals == ()


async def test_an_expired_proposal_is_listed_no_more(client: Any) -> None:
    await governor(client, "org-01").propose("settings", "set", {"name": "heartbeat_ms", "value": 9000})
    client.chain.time_ms += 8 * 24 * 3600 * 1000
    assert (await read_membership(client, READER)).proposals == ()


async def test_organisations_and_nodes_are_read_as_they_are(client: Any) -> None:
    client.chain.agree("add_org", organisation_fields("org-04"))
    client.chain.agree("add_node", node_fields("node-05", "org-04", custodian=True))
    client.chain.agree("remove_org", {"name": "org-03"})
    view = await read_membership(client, READER)
    assert [row.name for row in view.organisations] == ["org-01", "org-02", "org-04"]
    assert [row.name for row in view.nodes] == ["node-01", "node-02", "node-04", "node-05"]
    assert view.nodes[-1].custodian_key == key_of("node-05/custodian").public_key


async def test_seats_votes_readiness_and_evidence_are_read(client: Any) -> None:
    chain = client.chain
    chain.agree("add_node", node_fields("node-05", "org-01"))
    await governor(client, "org-01").vote("propose", producer_of("node-05").public_key)
    chain.ready("node-05")
    chain.must(producer_of("node-01"), "producers", "accuse", *chain.evidence(producer_of("node-02")))
    rows = {row.name: row for row in (await read_producers(client, READER)).candidates}
    assert [(name, row.turn) for name, row in rows.items()] == [
        ("node-01", 0),
        ("node-02", 1),
        ("node-03", 2),
        ("node-04", 3),
        ("node-05", None),
    ]
    assert (rows["node-02"].status, rows["node-02"].leads, rows["node-02"].evidence["round"]) == ("suspended", False, 7)
    assert (rows["node-05"].votes, rows["node-05"].ready_height) == (["org-01"], 3)
    assert rows["node-01"].evidence == {}


async def test_a_producer_is_voted_in_and_out(client: Any) -> None:
    key = producer_of("node-05").public_key
    client.chain.agree("add_node", node_fields("node-05", "org-01"))
    await governor(client, "org-01").vote("propose", key)
    client.chain.ready("node-05")
    assert (await governor(client, "org-02").vote("approve", key)).epoch == 1
    assert (await governor(client, "org-02").vote("withdraw", key)).epoch is None
    assert (await governor(client, "org-03").vote("remove", key)).epoch is None
    assert (await governor(client, "org-01").vote("remove", key)).epoch == 2


async def test_every_refusal_has_a_code_of_the_catalogue_and_the_contracts_sentence(client: Any) -> None:
    first = governor(client, "org-01")
    opened = await first.propose("membership", "remove_node", {"name": "node-04"})
    (row,) = (await read_membership(client, READER)).proposals
    refusals = [
        (
            Governor(client, key_of("stranger")).propose("settings", "set", {"name": "heartbeat_ms", "value": 1}),
            "GOVERNANCE_NOT_ADMIN",
            "admin",
        ),
        (Governor(client, key_of("org-01/registrar")).approve(row), "GOVERNANCE_NOT_ADMIN", "admin"),
        (first.approve(row), "GOVERNANCE_APPROVED_ALREADY", "one voice"),
        (governor(client, "org-02").withdraw(row), "GOVERNANCE_NOT_ADMIN", "proposed"),
        (
            first.propose("settings", "set", {"name": "heartbeat_ms", "value": 0}),
            "GOVERNANCE_SETTING_REFUSED",
            "3600000",
        ),
        (first.propose("membership", "remove_node", {"name": "x"}), "GOVERNANCE_REFUSED", "node"),
        (first.vote("propose", key_of("x").public_key), "GOVERNANCE_REFUSED", "node"),
    ]
    for work, code, word in refusals:
        error = await refusal_of(work)
        assert error.code == code
        assert word in error.detail
        assert "In contract" not in error.detail
    await first.withdraw(row)
    assert (await refusal_of(governor(client, "org-02").approve(row))).code == "GOVERNANCE_PROPOSAL_CLOSED"
    assert opened.proposal_id == row.id


async def test_the_last_of_its_kind_is_not_removed() -> None:
    client: Any = ConsortiumClient(Consortium(organisations=1, nodes=1))
    error = await refusal_of(governor(client, "org-01").vote("remove", producer_of("node-01").public_key))
    assert error.code == "GOVERNANCE_WOULD_STOP_CHAIN"


@pytest.mark.parametrize("text", ["", "abc", "zz" * 6, "00" * 32])
async def test_an_id_that_names_no_open_proposal_is_refused(client: Any, text: str) -> None:
    await governor(client, "org-01").propose("settings", "set", {"name": "heartbeat_ms", "value": 9000})
    view = await read_membership(client, READER)
    with pytest.raises(BlockRobotError, match="GOVERNANCE_PROPOSAL_CLOSED"):
        resolve_proposal(view.proposals, text)

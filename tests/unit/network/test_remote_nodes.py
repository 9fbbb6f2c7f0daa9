"""Nodes elsewhere: what each proves to everybody, and what is said of one that does not."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from dataclasses import replace
from pathlib import Path

import pytest

from clients.sdk.node_hints import HINTS
from consensus.chain import light_client
from consensus.errors import BlockRobotError
from network import remote_nodes
from network.cli.main import main
from network.doctor.answers import BEHIND_BLOCKS_COUNT, Answer, check_heights
from network.remote_nodes import RemoteNode, ask_remote_nodes
from node.directory.node_directory import DirectoryContent, content_of_genesis
from tests.unit.clients.sdk.certified_nodes import ELSEWHERE, CertifiedNodes


@pytest.fixture
async def nodes(tmp_path: Path) -> AsyncIterator[CertifiedNodes]:
    async with AsyncExitStack() as stack:
        nodes = CertifiedNodes(tmp_path, stack, "test")
        await nodes.ledger.start()
        yield nodes


def directory_of(nodes: CertifiedNodes, **urls: str) -> DirectoryContent:
    content = content_of_genesis(nodes.ledger.genesis)
    named = {name: replace(node, api_url=urls.get(name, node.api_url)) for name, node in content.nodes.items()}
    return replace(content, nodes=named)


async def ask(nodes: CertifiedNodes, **urls: str) -> dict[str, RemoteNode]:
    found = await ask_remote_nodes(nodes.ledger.genesis, directory_of(nodes, **urls), ["n3"])
    assert [node.name for node in found] == ["n0", "n1", "n2"]
    return {node.name: node for node in found}


async def test_each_is_asked_by_itself_and_proves_its_newest_final_block_through_the_epochs(
    nodes: CertifiedNodes,
) -> None:
    url = await nodes.serve("n0", host="127.0.0.1")
    await nodes.ledger.extend()
    await nodes.ledger.change_epoch()
    await nodes.ledger.extend()
    found = await ask(nodes, n0=url, n1="http://192.0.2.1:7273")
    assert (found["n0"].problem, found["n0"].finalized_height) == (None, nodes.ledger.header.height)
    assert (found["n0"].custodian, found["n1"].custodian) == (True, False)
    assert [found[name].problem.code for name in ("n1", "n2")] == [  # type: ignore[union-attr]
        "NODE_ADDRESS_UNUSABLE",
        "NODE_UNREACHABLE",
    ]
    assert found["n2"].finalized_height is None


async def test_an_address_that_is_typed_reaches_a_node_that_the_chain_names_elsewhere(nodes: CertifiedNodes) -> None:
    url = await nodes.serve("n0", host=ELSEWHERE)
    with main.make_context("blockrobot", ["--node", url, "status"]):
        found = await ask(nodes)
    assert (found["n0"].problem, found["n0"].api_url) == (None, url)


async def test_another_node_at_the_address_of_one_that_is_gone_does_not_answer_for_it(nodes: CertifiedNodes) -> None:
    url = await nodes.serve("n1", host="127.0.0.1")
    found = await ask(nodes, n0=url, n1=url)
    assert found["n1"].problem is None
    problem = found["n0"].problem
    assert problem is not None
    assert (problem.code, "'n1', not 'n0'" in problem.detail) == ("NODE_ADDRESS_WRONG", True)
    [gone] = [item for item in check_heights([], list(found.values())) if item.node == "n0"]
    assert "blockrobot org propose remove-node n0" in gone.next_step


async def test_a_proxys_own_certificate_is_no_other_node(nodes: CertifiedNodes) -> None:
    url = await nodes.serve("n0", shows="ward.example", host="127.0.0.1")
    assert (await ask(nodes, n0=url))["n0"].problem is None


async def test_a_node_of_another_chain_proves_nothing(nodes: CertifiedNodes, tmp_path: Path) -> None:
    other = CertifiedNodes(tmp_path, nodes.stack, "another")
    await other.ledger.start()
    url = await other.serve("n0", host="127.0.0.1")
    problem = (await ask(nodes, n0=url))["n0"].problem
    assert problem is not None
    assert problem.code == "GENESIS_DIFFERS", "it has no final block that could be of another chain"
    await other.ledger.extend()
    problem = (await ask(nodes, n0=url))["n0"].problem
    assert problem is not None
    assert problem.code in {"PROOF_INVALID", "CERTIFICATE_INVALID"}


async def test_what_one_proves_of_the_epochs_is_not_proved_again_of_another(
    nodes: CertifiedNodes, monkeypatch: pytest.MonkeyPatch
) -> None:
    urls = {name: await nodes.serve(name, host="127.0.0.1") for name in ("n0", "n1", "n2")}
    for _ in range(2):
        await nodes.ledger.extend()
        await nodes.ledger.change_epoch()
    proved = []
    check = light_client.verify_finality
    monkeypatch.setattr(light_client, "verify_finality", lambda *given: (proved.append(1), check(*given))[1])
    assert [node.problem for node in (await ask(nodes, **urls)).values()] == [None] * 3
    assert len(proved) == 2, "each of two boundaries once, for three nodes"


async def test_a_node_that_is_an_epoch_behind_is_shown_with_its_own_height(
    nodes: CertifiedNodes, tmp_path: Path
) -> None:
    behind = CertifiedNodes(tmp_path, nodes.stack, "test")
    await behind.ledger.start()
    assert behind.ledger.genesis == nodes.ledger.genesis
    for ledger in (nodes.ledger, behind.ledger):
        await ledger.extend()
    await nodes.ledger.change_epoch()
    urls = {"n0": await nodes.serve("n0", host="127.0.0.1"), "n1": await behind.serve("n1", host="127.0.0.1")}
    found = await ask(nodes, **urls)
    assert [found[name].finalized_height for name in ("n0", "n1")] == [2, 1]


async def test_all_nodes_together_have_so_long_and_no_longer(
    nodes: CertifiedNodes, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = await nodes.serve("n0", host="127.0.0.1")
    monkeypatch.setattr(remote_nodes, "ASK_ALL_REMOTE_MAX_S", 0.0)
    problem = (await ask(nodes, n0=url))["n0"].problem
    assert problem is not None
    assert (problem.code, "within 0 s" in problem.detail) == ("NODE_UNREACHABLE", True)


async def test_a_node_that_was_typed_and_is_on_no_list_here_is_asked_too(nodes: CertifiedNodes) -> None:
    url, told = await nodes.serve("n9"), list[tuple[int, int]]()
    with main.make_context("blockrobot", ["--node", url, "status"]):
        found = await ask_remote_nodes(
            nodes.ledger.genesis, directory_of(nodes), (), lambda _what, done, of: told.append((done, of))
        )
    newcomer = found[-1]
    assert (newcomer.name, newcomer.organisation, newcomer.api_url) == ("n9", "ward", url)
    assert (newcomer.problem, newcomer.custodian) == (None, None)
    assert told == [(done, len(found)) for done in range(len(found) + 1)]


async def test_what_is_typed_is_used_or_refused_where_nobody_else_can_be_asked(nodes: CertifiedNodes) -> None:
    """As on a machine that has all nodes that its chain names."""
    here, told = [f"n{number}" for number in range(4)], list[BlockRobotError]()
    url = await nodes.serve("n9")
    with main.make_context("blockrobot", ["--node", url, "--node", "https://127.0.0.1:9", "status"]):
        HINTS.tell = told.append
        (found,) = await ask_remote_nodes(nodes.ledger.genesis, directory_of(nodes), here)
    assert (found.name, found.problem) == ("n9", None)
    assert [refusal.code for refusal in told] == ["NODE_UNREACHABLE"]


def remote(name: str, height: int | None) -> RemoteNode:
    return RemoteNode(
        name=name,
        organisation="ward",
        api_url="https://a.example",
        custodian=False,
        finalized_height=height,
        finalized_ms=None,
        answered_in_ms=None,
        problem=None,
    )


def test_the_doctor_compares_heights_here_and_elsewhere() -> None:
    far = BEHIND_BLOCKS_COUNT + 1
    here = Answer("n0", True, {"finalized_height": 0})
    assert [(item.code, item.node) for item in check_heights([here], [remote("n1", far)])] == [("NODE_BEHIND", "n0")]
    ahead = Answer("n0", True, {"finalized_height": far})
    assert [(item.code, item.node) for item in check_heights([ahead], [remote("n1", 0)])] == [
        ("REMOTE_NODE_BEHIND", "n1")
    ]
    assert check_heights([here], [remote("n1", far - 1)]) == []


async def test_the_doctor_names_a_node_elsewhere_that_does_not_answer(nodes: CertifiedNodes) -> None:
    found = await ask(nodes)
    findings = check_heights([], list(found.values()))
    assert {(item.code, item.kind.severity) for item in findings} == {("REMOTE_NODE_SILENT", "warning")}
    assert len(findings) == len(found)
    assert findings[0].detail.startswith("Asked at https://127.0.0.1:9 (ward): ")

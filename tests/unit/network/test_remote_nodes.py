"""Nodes elsewhere: what each proves to everybody, and what is said of one that does not."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from dataclasses import replace
from pathlib import Path

import pytest

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


async def test_a_node_of_another_chain_proves_nothing(nodes: CertifiedNodes, tmp_path: Path) -> None:
    other = CertifiedNodes(tmp_path, nodes.stack, "another")
    await other.ledger.start()
    await other.ledger.extend()
    url = await other.serve("n0", host="127.0.0.1")
    problem = (await ask(nodes, n0=url))["n0"].problem
    assert problem is not None
    assert problem.code in {"PROOF_INVALID", "CERTIFICATE_INVALID"}


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

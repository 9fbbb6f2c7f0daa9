"""The chain's contracts over HTTP: versions, interfaces, sources, and what is due."""

from __future__ import annotations

from typing import Any

import pytest

from contracts.lifecycle.registry import compute_source_hash, read_source
from tests.unit.contracts.system.consortium import Consortium
from tests.unit.contracts.system.deploying import FAILING, VISITORS, VISITORS_2, agree, deploy, disabling, upgrade
from tests.unit.node.api.small_network import SUBJECT, SmallNode


async def put_lifecycle(node: SmallNode, chain: Consortium) -> None:
    """Finalize a block that has the lifecycle of another chain."""
    rows = [row for prefix in (b"lifecycle\x00", b"machine\x00") for row in chain.state.scan(prefix, 10_000)]
    await node.ledger.extend(writes=dict(rows))


@pytest.fixture
def read(api: Any, open_session: Any) -> Any:
    async def get(path: str) -> tuple[int, dict[str, Any]]:
        answer = await api.get(f"/v1/contracts{path}", headers=await open_session(SUBJECT))
        return answer.status, await answer.json()

    return get


async def test_contracts_are_listed_with_what_is_due(node: SmallNode, read: Any) -> None:
    chain = Consortium()
    upgrade(chain, "visitors", VISITORS)
    height = deploy(chain, "visitors", VISITORS_2, delay=20)
    await put_lifecycle(node, chain)
    status, document = await read("")
    assert (status, document["height"]) == (200, 1)
    found = {row["name"]: row for row in document["contracts"]}
    assert found["visitors"]["versions"] == 2
    assert found["visitors"]["version"] == 1
    assert found["visitors"]["source_hash"] == compute_source_hash(VISITORS).hex()
    assert found["records"]["enabled"]
    assert document["due"] == [
        {"kind": "activate", "name": "visitors", "version": 2, "from_height": height, "from_ms": 0}
    ]


async def test_a_version_is_served_with_interface_and_source(node: SmallNode, read: Any) -> None:
    chain = Consortium()
    upgrade(chain, "visitors", VISITORS)
    upgrade(chain, "visitors", VISITORS_2)
    await put_lifecycle(node, chain)
    _, now = await read("/visitors")
    assert (now["version"], now["status"], now["source"], now["migrates"]) == (2, "active", VISITORS_2, True)
    assert now["abi"] == [
        {
            "name": "enter",
            "kind": "export",
            "parameters": [{"name": "name", "type": "str"}, {"name": "floor", "type": "int"}],
            "required": 2,
            "returns": "object",
        },
        {"name": "inside", "kind": "view", "parameters": [], "required": 0, "returns": "list"},
    ]
    _, former = await read("/visitors?version=1")
    assert (former["status"], former["source"], former["organisation"]) == ("superseded", VISITORS, "org-01")
    _, shipped = await read("/records")
    assert (shipped["source"], shipped["proposal_id"]) == (read_source("records"), "")


async def test_a_failed_version_says_why_and_a_disabled_one_rests(node: SmallNode, read: Any) -> None:
    chain = Consortium()
    upgrade(chain, "visitors", VISITORS)
    upgrade(chain, "visitors", FAILING)
    agree(chain, "disable", disabling("visitors"))
    chain.block([])
    await put_lifecycle(node, chain)
    _, failed = await read("/visitors?version=2")
    assert (failed["status"], failed["failure"][:9]) == ("failed", "TOO_EARLY")
    assert (await read("/visitors"))[1]["status"] == "disabled"
    rows = {row["name"]: row for row in (await read(""))[1]["contracts"]}
    assert not rows["visitors"]["enabled"]


@pytest.mark.parametrize("path", ["/nothing", "/records?version=2", "/Records", "/records%00x"])
async def test_what_the_chain_does_not_have_is_not_found(node: SmallNode, read: Any, path: str) -> None:
    await put_lifecycle(node, Consortium())
    status, problem = await read(path)
    assert (status, problem["code"]) == (404, "CONTRACT_NOT_FOUND")

"""Of an empty frame that no custodian gives, only a proof says that it was withdrawn."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from clients.sdk.connections import NodeAddress
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode_value
from consensus.primitives.hashing import sha256
from tests.unit.clients.sdk.conftest import DEAD_URL
from tests.unit.node.api.small_network import OWNER, flat


async def test_that_an_empty_frame_was_withdrawn_is_believed_of_the_chain_alone(nodes: Any) -> None:
    """A custodian that has none may have lost it; one that is away may have it."""
    client, ledger = nodes.client(), nodes["n0"].node.ledger
    approved, gone, missing = sha256(b"approved"), sha256(b"gone"), dict[bytes, BlockRobotError]()
    await ledger.extend(writes={flat("records", b"empty-frame/" + approved): encode_value(1)})
    for digest in (approved, gone):
        assert await client.custody.find_background(digest, OWNER, missing) is None
    assert {digest: error.code for digest, error in missing.items()} == {
        approved: "NOT_FOUND",
        gone: "EMPTY_FRAME_WITHDRAWN",
    }
    nodes["n0"].node.custody.backgrounds[gone] = b"gone"
    assert await client.custody.find_background(gone, OWNER, missing) is None, "it is asked for once"


async def test_an_empty_frame_of_a_custodian_that_is_away_is_not_called_withdrawn(
    nodes: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    client, ledger, missing = nodes.client(), nodes["n0"].node.ledger, dict[bytes, BlockRobotError]()
    digest = sha256(b"kept by who is away")
    await ledger.extend(writes={flat("records", b"empty-frame/" + digest): encode_value(1)})
    there, away = client.custody.custodians[0], NodeAddress("n9", DEAD_URL)
    for custodians in ((there, away), (away, there)):
        missing.clear()
        monkeypatch.setattr(client.custody, "_book", SimpleNamespace(custodians=custodians))
        assert await client.custody.find_background(digest, OWNER, missing) is None
        assert missing[digest].code == "NODE_UNREACHABLE"

    async def prove_nothing(*_: Any) -> None:
        raise BlockRobotError("NODE_UNREACHABLE")

    missing.clear()
    monkeypatch.setattr(client.custody, "_book", SimpleNamespace(custodians=(there,)))
    monkeypatch.setattr(client.custody, "_prove", prove_nothing)
    assert await client.custody.find_background(digest, OWNER, missing) is None
    assert missing[digest].code == "NOT_FOUND", "nobody could prove that it was withdrawn"

"""What a node that nobody hears does with transactions: it says so, and the client goes on to another."""

from __future__ import annotations

import pytest

from consensus.errors import BlockRobotError
from node.mempool.transaction_intake import ClientPool
from tests.unit.node.api.small_network import FakePool, ManualClock, SmallLedger


@pytest.mark.parametrize("code", ["NODE_REMOVED", "CERTIFICATE_EXPIRED", "CERTIFICATE_REVOKED"])
async def test_a_node_that_no_peer_hears_takes_nothing_and_still_answers(code: str) -> None:
    problems: list[BlockRobotError] = [BlockRobotError(code)]
    inner = FakePool(await SmallLedger().start(), ManualClock())
    pool = ClientPool(inner, lambda: problems[0] if problems else None)
    with pytest.raises(BlockRobotError, match=f"^{code}:"):
        await pool.submit([b"anything"])
    assert pool.status(bytes(32)) == "unknown"
    problems.clear()
    (result,) = await pool.submit([b"anything"])
    assert result.error is not None
    assert result.error.code != code

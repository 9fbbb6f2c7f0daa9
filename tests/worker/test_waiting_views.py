"""Views that wait for the one worker: who asks many at once leaves places for others, who are answered."""

from __future__ import annotations

import asyncio

from consensus.errors import BlockRobotError
from contracts.worker.worker_machine import WorkerSpec
from node.api_adapters import FinalizedLedger
from node.execution.sandboxed_contracts import VIEWS_OF_SOURCE_MAX_COUNT, VIEWS_WAITING_MAX_COUNT, SandboxedContracts
from node.ledger.ledger_writer import FinalityFeed
from node.limits.token_buckets import Source
from tests.worker.written_blocks import Chain


async def test_a_source_that_asks_more_than_its_share_at_once_is_refused_and_others_are_answered(
    chain: Chain, staff: WorkerSpec
) -> None:
    finalized = FinalizedLedger(chain.store, FinalityFeed(0))
    contracts = SandboxedContracts("on", staff, chain.store)
    member = chain.hospital.registrar.public_key

    async def ask(source: Source) -> str:
        with finalized.snapshot() as snapshot:
            try:
                await contracts.views.run_view(snapshot, "identity", "role_of", [member], source)
            except BlockRobotError as error:
                return error.code
            return "answered"

    greedy, modest = Source("session", "greedy"), Source("session", "modest")
    try:
        told = await asyncio.gather(*(ask(greedy) for _ in range(VIEWS_WAITING_MAX_COUNT)), ask(modest))
        assert told.pop() == "answered"
        assert told.count("answered") == VIEWS_OF_SOURCE_MAX_COUNT
        assert set(told) == {"answered", "RATE_LIMITED"}
        assert await ask(greedy) == "answered"
    finally:
        await contracts.close()

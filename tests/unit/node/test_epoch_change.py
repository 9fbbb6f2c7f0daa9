"""A schedule change on running nodes: each goes over by itself, late ones are helped, and a restart finds its epoch."""

from __future__ import annotations

from consensus.block import EpochProof
from consensus.primitives.encoding import decode
from contracts.execution.epochs import read_epoch
from tests.unit.node.small_nodes import SmallNodes, make_genesis
from tests.virtual_time import run_virtual, virtual_now_ms

NAMES = ["a", "b", "c", "d"]


def test_a_change_of_settings_begins_an_epoch_on_all_nodes_and_the_chain_goes_on() -> None:
    async def story() -> None:
        crowd = SmallNodes(make_genesis(NAMES))
        await crowd.start()
        await crowd.finalize("a", crowd.transaction("settings", "propose", "base_timeout_ms", 400))
        changed_ms = virtual_now_ms()
        await crowd.wait_epoch(1)
        assert virtual_now_ms() - changed_ms < 1_000
        for node in crowd.nodes.values():
            assert node.engine.epoch.epoch.settings.base_timeout_ms == 400
        await crowd.finalize("b", crowd.transaction("identity", "authenticate", bytes(32)))
        await crowd.finalize("c", crowd.transaction("identity", "authenticate", bytes(32)))
        assert virtual_now_ms() - changed_ms < 2_000
        assert len(crowd.roots()) == 1
        assert not any(node.peers._handover.silent for node in crowd.nodes.values())
        with crowd.ledgers["d"].snapshot() as snapshot:
            data = snapshot.epoch_proof(1)
            assert data is not None
            assert decode(data, EpochProof).epoch == read_epoch(snapshot)
        await crowd.stop()

    run_virtual(story())

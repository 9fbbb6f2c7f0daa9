"""`python -m network.byzantine.process --data-dir DIR --behaviour equivocate [--seed 7]`: a Byzantine local node.

Its node.toml must allow faults.
"""

from __future__ import annotations

import argparse
import asyncio
import sys
from collections.abc import Sequence
from pathlib import Path
from random import Random

import structlog

from consensus.errors import BlockRobotError
from network.byzantine.behaviour import TICK_MS, Behaviour, EngineView
from network.byzantine.catalogue import BEHAVIOURS, byzantine_clock, check_behaviour, make_behaviour
from node.api_adapters import WallClock
from node.components import NodeComponents
from node.config import NodeConfig, load_genesis
from node.consensus.engine import Outbox
from node.main import run_process
from node.node_process import Node

log = structlog.get_logger(__name__)


class _BentClock(WallClock):
    def __init__(self, behaviour: str, max_clock_drift_ms: int) -> None:
        super().__init__()
        self._bent_ms = byzantine_clock(behaviour, super().now_ms, max_clock_drift_ms)

    def now_ms(self) -> int:
        return self._bent_ms()


class ByzantineNode(Node):
    """A node with a behaviour around its outbox."""

    def __init__(self, config: NodeConfig, behaviour: str, seed: int) -> None:
        """Raises FAULT_UNKNOWN, FAULTS_DISABLED, and `Node` errors."""
        check_behaviour(behaviour)
        if not config.faults_enabled:
            raise BlockRobotError("FAULTS_DISABLED")
        if config.producer_key_path is None:
            raise BlockRobotError("FAULT_INVALID", f"{config.name} is no producer: it has nothing to lie about.")
        genesis = load_genesis(config)
        self._ticking: asyncio.Task[None] | None = None

        def wrap(outbox: Outbox, parts: NodeComponents) -> Outbox:
            key = parts.surroundings.key  # as the honest node has it: it may have joined later, or have a new key
            if key is None:
                raise BlockRobotError("FAULT_INVALID", f"{config.name} has no producer key.")
            view = EngineView(parts.engine, genesis.chain_id, parts.network)
            liar = make_behaviour(behaviour, inner=outbox, own=view, key=key, chance=Random(seed))  # noqa: S311
            self._ticking = asyncio.get_running_loop().create_task(_tick(liar), name="byzantine")
            log.warning("byzantine", behaviour=behaviour, seed=seed)
            return liar

        drift_ms = genesis.settings.max_clock_drift_ms
        super().__init__(config, clock=_BentClock(behaviour, drift_ms), wrap_outbox=wrap)

    async def __aexit__(self, *reason: object) -> None:
        if self._ticking is not None:
            self._ticking.cancel()
            await asyncio.gather(self._ticking, return_exceptions=True)
        await super().__aexit__(*reason)  # type: ignore[arg-type]


async def _tick(liar: Behaviour) -> None:
    while True:
        await asyncio.sleep(TICK_MS / 1000)
        liar.tick()


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m network.byzantine.process", description="Run one lying node.")
    parser.add_argument("--data-dir", type=Path, required=True, help="the node's data directory")
    parser.add_argument("--behaviour", required=True, help=f"one of {', '.join(BEHAVIOURS)}, or several joined with +")
    parser.add_argument("--seed", type=int, default=0, help="what the lies are drawn from")
    options = parser.parse_args(arguments)
    return run_process(options.data_dir, lambda config: ByzantineNode(config, options.behaviour, options.seed))


if __name__ == "__main__":
    sys.exit(main())

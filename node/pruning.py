"""Drops the bodies of old blocks. Must never drop one whose effects the node's own custodian has not brought about.

What stays of a pruned block is its header (with the certificate of its parent), the places of its transactions and the
txids of the replay window; epoch proofs and the state, with the audit in it, are not touched.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Any

import structlog

from consensus.errors import BlockRobotError
from node.config import KEEP_BLOCKS_MIN_COUNT, NodeConfig
from node.offchain.open_store import open_store
from node.snapshot.making import header_of_block
from node.storage.ledger_store import LedgerStore
from node.storage.lmdb_store import LmdbStore

REQUEST_FILE_NAME = "prune.request"
PRUNE_SLACK_COUNT = 64
"""A running node prunes this many blocks at once, or none."""

log = structlog.get_logger(__name__)


async def prune_ledger(ledger: LedgerStore, below_height: int) -> int:
    """Prune step by step, letting others work in between; return the earliest height that keeps its body."""
    while True:
        earliest = await ledger.prune(below_height, header_of_block)
        position = ledger.position
        if earliest >= min(below_height, 0 if position is None else position.height):
            return earliest
        await asyncio.sleep(0)


def highest_prunable(head: int, keep: int, followed: int | None) -> int:
    """Return the height below which bodies may go: `keep` stay, and all that the custodian still has to follow.

    `followed` is the height of the custodian's checkpoint, -1 if it has none yet, None without a custodian.
    """
    below = head - keep + 1
    return max(0, below if followed is None else min(below, followed + 1))


class Pruner:
    """Prunes a running node's ledger now and then; `keep` of 0 keeps everything. `followed` as above."""

    def __init__(self, ledger: LedgerStore, keep: int, followed: Callable[[], int | None]) -> None:
        self._ledger = ledger
        self._keep = keep
        self._followed = followed
        self._done_below = 0

    async def prune_to(self, keep: int) -> None:
        """Prune now, as somebody asked: `keep` stay, and what the custodian has yet to follow."""
        position = self._ledger.position
        head = 0 if position is None else position.height
        await prune_ledger(self._ledger, highest_prunable(head, max(keep, KEEP_BLOCKS_MIN_COUNT), self._followed()))

    async def run_once(self) -> None:
        """Prune if enough has piled up. A refusal of the store is logged; the next time may work."""
        position = self._ledger.position
        if not self._keep or position is None:
            return
        below = highest_prunable(position.height, self._keep, self._followed())
        if below < self._done_below + PRUNE_SLACK_COUNT:
            return
        try:
            self._done_below = await prune_ledger(self._ledger, below)
        except BlockRobotError as error:
            log.warning("prune_failed", code=error.code, detail=error.detail)
            return
        log.info("ledger_pruned", earliest_height=self._done_below)


def request_pruning(data_dir: Path, keep: int) -> Path:
    """Ask the node that runs on a data directory to prune; return the file that is gone once it has."""
    path = data_dir / REQUEST_FILE_NAME
    temporary = path.with_suffix(".tmp")
    temporary.write_text(str(keep), encoding="ascii")
    temporary.replace(path)
    return path


async def answer_requests(data_dir: Path, pruner: Pruner) -> None:
    """Prune if somebody who may write to the data directory asked for it; a request that makes no sense is dropped."""
    path = data_dir / REQUEST_FILE_NAME
    try:
        keep = int(path.read_text(encoding="ascii"))
        await pruner.prune_to(keep)
    except FileNotFoundError:
        return
    except (ValueError, OSError, BlockRobotError) as error:
        log.warning("prune_request_failed", detail=str(error))
    path.unlink(missing_ok=True)


async def prune_stopped_node(config: NodeConfig, keep: int) -> dict[str, Any]:
    """Prune the ledger of a node that is not running; the data directory's lock must be held.

    Returns `height`, `earliest_height` and whether the custodian's checkpoint kept it from dropping more. Raises
    DATA_DIRECTORY_INVALID, STORAGE_*, STORE_UNAVAILABLE.
    """
    followed: int | None = None
    if config.custodian_key_path is not None:
        async with open_store(config.custody_store, config.custody_dir) as store:
            checkpoint = await store.checkpoint()
            followed = -1 if checkpoint is None else checkpoint.height
    ledger = LmdbStore.open(config.ledger_dir)
    try:
        head = 0 if ledger.position is None else ledger.position.height
        below = highest_prunable(head, keep, followed)
        earliest = await prune_ledger(ledger, below)
    finally:
        await ledger.close()
    wanted = highest_prunable(head, keep, None)
    return {"height": head, "earliest_height": earliest, "held_back_by_custody": earliest < wanted}

"""Mutants of what custodians owe each other and the chain: repair, erasure of copies in unexpected places, receipts."""

from __future__ import annotations

from typing import Any

import pytest

from node.custody.block_effects import BlockApplier
from node.custody.clip_fetching import ClipFetcher
from node.custody.custodian import Custodian
from node.custody.stores.custody_store import OutboxRow
from tests.sim.mutants.mutant import Mutant
from tests.sim.mutants.schedules import CUSTODY


def repair_nothing(patch: pytest.MonkeyPatch) -> None:
    """Whoever joins or leaves, what others were to keep is not fetched."""

    async def follow_placement(self: ClipFetcher) -> int:
        return 0

    patch.setattr(ClipFetcher, "follow_placement", follow_placement)


def erase_as_keeper_only(patch: pytest.MonkeyPatch) -> None:
    """A copy that others are to keep by now is left where it is."""
    on_erasure = BlockApplier._on_erasure

    async def own_alone(self: BlockApplier, data: dict[str, Any]) -> None:
        own = [each for each in data["records"] if self._placement.is_keeper(self._member, each)]
        await on_erasure(self, {**data, "records": own})

    patch.setattr(BlockApplier, "_on_erasure", own_alone)


def confirm_nothing(patch: pytest.MonkeyPatch) -> None:
    """Receipts are written, and never sent."""

    async def words_alone(self: Custodian, limit: int) -> list[OutboxRow]:
        return await self._store.outbox("ready", "access", limit)

    patch.setattr(Custodian, "ready_outbox", words_alone)


KEEPING = (
    Mutant("repair nothing", "copies", repair_nothing, CUSTODY, frozenset({"copies"})),
    Mutant(
        "erase as a keeper only", "erased everywhere", erase_as_keeper_only, CUSTODY, frozenset({"erased_means_erased"})
    ),
    Mutant("confirm nothing", "erased everywhere", confirm_nothing, CUSTODY, frozenset({"erasures_confirmed"})),
)

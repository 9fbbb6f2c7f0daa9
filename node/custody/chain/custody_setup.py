"""Builds a node's custodian from key, store and erase keys."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from consensus.primitives.keys import PrivateKey
from consensus.state.records import EMPTY_FRAME
from node.budgets.disk_reserve import DiskReserve
from node.custody.custodian import Custodian
from node.custody.erase_keys import ErasableKeys
from node.custody.stores.custody_store import CustodyStore
from node.storage.ledger_store import LedgerStore


@dataclass(frozen=True, slots=True)
class CustodyPlace:
    """A custodian's key, open store and open erase keys; closed by their owner."""

    key: PrivateKey
    store: CustodyStore
    erase_keys: ErasableKeys
    reserve: DiskReserve | None = None

    def make_custodian(self, ledger: LedgerStore, clock_ms: Callable[[], int]) -> Custodian:
        """Return the custodian; `ledger` gives the approved empty frames."""

        def is_frame_approved(digest: bytes) -> bool:
            with ledger.snapshot() as snapshot:
                return EMPTY_FRAME.has(snapshot, digest)

        return Custodian(
            self.store,
            self.erase_keys,
            member=self.key.public_key,
            clock_ms=clock_ms,
            has_room=None if self.reserve is None else self.reserve.has_room,
            is_frame_approved=is_frame_approved,
        )

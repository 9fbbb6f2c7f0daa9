"""The hospital's custodians: each with its database and erase keys in its node's folder, and what it owes to the chain."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator, Sequence
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass
from typing import Any

from consensus.chain.transaction import Transaction
from consensus.primitives.encoding import decode_value
from consensus.primitives.keys import PrivateKey
from consensus.records.clips import ClipDownload, ClipUpload
from network.lab.year.chain import HospitalChain, Spent
from node.config import NodeConfig
from node.custody.chain_facts import ChainFacts
from node.custody.custodian import Custodian
from node.custody.erase_keys import EraseKeys
from node.custody.erasure import EXPIRED_KIND
from node.custody.finalized_events import FinalizedEvents
from node.custody.repair.scrub import ScrubReport, scrub
from node.custody.stores.custody_store import Checkpoint, OutboxRow
from node.custody.stores.sqlite_store import SqliteStore
from node.custody.uploads.upload_usage import UploadTerms
from node.storage.lmdb_store import LmdbStore

OUTBOX_BATCH_COUNT = 64


@contextmanager
def facts_of(ledger: LmdbStore) -> Iterator[ChainFacts]:
    """What the chain says at its newest block."""
    with ledger.snapshot() as snapshot:
        position = snapshot.position
        assert position is not None, "the ledger has blocks"
        yield ChainFacts(snapshot, Checkpoint(position.height, position.block_id, position.timestamp_ms))


@dataclass(slots=True)
class CustodianPlace:
    """One open custodian, which keeps every clip. For others it is a peer, who gives a missing one."""

    name: str
    config: NodeConfig
    key: PrivateKey
    store: SqliteStore
    keys: EraseKeys
    custodian: Custodian

    @property
    def member(self) -> bytes:
        return self.key.public_key

    async def fetch(self, record_id: bytes) -> ClipDownload | None:
        return await self.custodian.export(record_id)

    async def scrub(self, ledger: LmdbStore) -> ScrubReport:
        return await scrub(self.custodian, self.store, self.keys, lambda: facts_of(ledger))


@asynccontextmanager
async def open_place(config: NodeConfig, key: PrivateKey, clock_ms: Callable[[], int]) -> AsyncIterator[CustodianPlace]:
    with EraseKeys(config.erase_keys_dir) as keys:
        async with SqliteStore(config.custody_dir) as store:
            custodian = Custodian(store, keys, member=key.public_key, clock_ms=clock_ms)
            await custodian.start()
            yield CustodianPlace(config.name, config, key, store, keys, custodian)


class Custodians:
    """All custodians of the hospital, which follow its chain block by block."""

    def __init__(self, chain: HospitalChain, spent: Spent, places: Sequence[CustodianPlace]) -> None:
        self._chain, self._spent, self.places = chain, spent, places

    async def stage(self, upload: ClipUpload, terms: UploadTerms) -> None:
        with self._spent.on("upload"):
            await asyncio.gather(*(place.custodian.stage(upload, terms) for place in self.places))

    async def follow(self, events: FinalizedEvents) -> None:
        """Time counts as erasure or expiry if the block made custodians erase."""
        before = self._spent.seconds["block without erasure"]
        with self._spent.on("block without erasure"):
            await asyncio.gather(*(place.custodian.on_finalized_block(events) for place in self.places))
        kind = None
        if any(event.kind == "erasure.requested" for event in events.events):
            kind = "erasure"
        elif await self._expired_in(events.height):
            kind = "expiry"
        if kind is not None:
            took_s = self._spent.seconds["block without erasure"] - before
            self._spent.seconds["block without erasure"] = before
            self._spent.seconds[kind] += took_s

    async def _expired_in(self, height: int) -> bool:
        rows = await self.places[0].store.outbox("ready", "erasure", OUTBOX_BATCH_COUNT)
        return any((row.kind, row.height) == (EXPIRED_KIND, height) for row in rows)

    async def owed(self) -> dict[bytes, tuple[Transaction, CustodianPlace, OutboxRow]]:
        """What the custodians have to say on the chain, signed, by its txid: said anew until the chain shows it."""
        found = {}
        for place in self.places:
            for row in await place.custodian.ready_outbox(OUTBOX_BATCH_COUNT):
                arguments: list[Any] = decode_value(row.arguments)
                call = self._chain.sign(place.key, row.contract, row.entry, *arguments)
                found[call.txid] = (call, place, row)
        return found

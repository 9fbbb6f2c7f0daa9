"""What a ledger costs beside state, chain and members: blocks, commits, proofs, starts, the explorer, snapshots."""

from __future__ import annotations

import secrets
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Any

from consensus.chain.transaction import Transaction, decode_transaction, sign_transaction
from consensus.limits import RETENTION_DEFAULT_MS, SEALED_METADATA_BYTES, TIME_BUCKET_MS
from consensus.primitives.keys import PrivateKey
from consensus.records.commitments import derive_record_id
from contracts.execution.sender_admission import require_admission
from contracts.state.view import StateView
from network.bench.growth.growth_figures import SizeFigures
from network.bench.growth.growth_ledgers import LEDGER, BlockMaker, call_id, open_chain
from network.bench.growth.growth_rows import PURPOSE, ROBOT
from network.bench.growth.growth_timing import Spent, Tell, time_operation, time_scan
from node.api.chain_headers import HeaderReader, count_all
from node.api_adapters import DecodedSnapshot
from node.directory.node_directory import Directory
from node.execution.block_executor import Executor
from node.execution.execution_machines import BlockExecutionResult
from node.snapshot.making import make_snapshot
from node.storage.lmdb_store import LmdbStore

CALLS_A_BLOCK_COUNT = 16
EVENTS_PAGE_COUNT = 50
_SALT_BYTES = 8
Measured = AsyncIterator[tuple[str, SizeFigures]]


class LedgerGrowth:
    """One open ledger, to which blocks of a robot's calls are added."""

    def __init__(self, folder: Path, store: LmdbStore) -> None:
        self.chain, self.folder, self.store = open_chain(), folder, store
        self.maker = BlockMaker.behind(self.chain, store)
        self._owner = PrivateKey(secrets.token_bytes(32)).public_key

    @property
    def _now_ms(self) -> int:
        return self.maker.next_ms

    def _sign(self, entry: str, arguments: list[Any]) -> Transaction:
        signed = sign_transaction(
            ROBOT,
            chain_id=self.chain.genesis.chain_id,
            contract="records",
            entry=entry,
            arguments=arguments,
            valid_until_ms=self._now_ms + 60_000,
            salt=secrets.token_bytes(_SALT_BYTES),
        )
        return decode_transaction(signed.wire)

    def _bucket_ms(self) -> int:
        return self._now_ms - self._now_ms % TIME_BUCKET_MS

    def _visit(self) -> Transaction:
        return self._sign("open_visit", [self._owner, self._owner, 7, self._bucket_ms(), PURPOSE])

    def _record(self) -> Transaction:
        root, expires_ms = secrets.token_bytes(32), self._now_ms + RETENTION_DEFAULT_MS
        metadata = bytes(SEALED_METADATA_BYTES)
        record_id = derive_record_id(self._owner, root)
        arguments = [record_id, self._owner, root, root, metadata, self._bucket_ms(), expires_ms]
        return self._sign("record", arguments)

    def _execute(self, parent: StateView, calls: list[Transaction]) -> BlockExecutionResult:
        height, time_ms = self.maker.parent.height + 1, self._now_ms
        result = self.chain.machine.verify(parent, height, time_ms, calls)
        refused = [receipt.message for receipt in result.receipts if not receipt.ok]
        if refused:
            raise RuntimeError(f"a call of the benchmark was refused: {refused[0]}")
        return result

    async def block(self, executing: Spent, committing: Spent) -> None:
        """Another visit each time, since one lasts for ten minutes."""
        self._owner = PrivateKey(secrets.token_bytes(32)).public_key
        calls = [self._visit(), *(self._record() for _ in range(CALLS_A_BLOCK_COUNT - 1))]
        with self.store.snapshot() as parent, executing.once():
            result = self._execute(parent, calls)
        block = self.maker.of_result(result, calls)
        finality = self.maker.finality()
        with committing.once():
            await self.store.commit([block], finality)

    async def admit(self, spent: Spent) -> None:
        call = self._record()
        with self.store.snapshot() as snapshot, spent.once():
            require_admission(snapshot, call, self._now_ms)

    async def prove(self, key: bytes, spent: Spent) -> None:
        """Of a row that is there, and of one that is not."""
        with self.store.snapshot() as snapshot, spent.once():
            snapshot.prove(key)
            snapshot.prove(secrets.token_bytes(32))

    async def search(self, heights: int, spent: Spent) -> None:
        """A header by height and by id, a call by its txid, a page of events, and what the first page counts."""
        height = 2 + secrets.randbelow(heights)
        with self.store.snapshot() as raw, spent.once():
            snapshot = DecodedSnapshot(raw)
            header = HeaderReader(snapshot, self.chain.genesis).read(height)
            place = snapshot.locate(call_id(height))
            if header is None or place is None or snapshot.receipt(place.height, place.index) is None:
                raise RuntimeError(f"block {height} of the benchmark is not found")
            if snapshot.block_height(bytes.fromhex(header.block_id)) != height:
                raise RuntimeError(f"block {height} of the benchmark has another id")
            snapshot.events(height, 0, EVENTS_PAGE_COUNT)
            count_all(snapshot)


class _Emptiness:
    """Takes a snapshot's chunks and keeps nothing."""

    def put_chunk(self, index: int, data: bytes) -> None: ...

    def put_manifest(self, data: bytes) -> None: ...


async def _start(folder: Path, spent: Spent) -> None:
    """What a node reads of its ledger before it serves."""
    chain = open_chain()
    with spent.once():
        store = LmdbStore.open(folder / LEDGER)
        executor = Executor(
            genesis=chain.genesis, ledger=store, machine=chain.machine, cache=chain.transactions, key=None
        )
        with store.snapshot() as snapshot:
            Directory.of_genesis(chain.genesis).refresh(snapshot, executor.base_height)
            snapshot.recent_txids(0)
    executor.close()
    await store.close()


async def _snapshot(store: LmdbStore, tell: Tell) -> None:
    with store.snapshot() as ledger:
        make_snapshot(ledger, _Emptiness(), lambda _chunks, _bytes: tell())


@asynccontextmanager
async def open_growth(folder: Path) -> AsyncIterator[LedgerGrowth]:
    store = LmdbStore.open(folder / LEDGER)
    try:
        yield LedgerGrowth(folder, store)
    finally:
        await store.close()


async def _blocks(bench: LedgerGrowth, size: int) -> Measured:
    committing = Spent()

    async def run(spent: Spent) -> None:
        await bench.block(spent, committing)

    yield "execution of a block", await time_operation(size, run)
    yield "commit of a block", committing.summarise(size)


async def measure_state(folder: Path, size: int, key: Callable[[int], bytes]) -> Measured:
    yield "node start: ledger", await time_operation(size, partial(_start, folder))
    async with open_growth(folder) as bench:

        async def prove(spent: Spent) -> None:
            await bench.prove(key(secrets.randbelow(size)), spent)

        async for measured in _blocks(bench, size):
            yield measured
        yield "state proof", await time_operation(size, prove)
        yield "snapshot", await time_scan(size, partial(_snapshot, bench.store))


async def measure_chain(folder: Path, size: int) -> Measured:
    yield "node start: ledger", await time_operation(size, partial(_start, folder))
    async with open_growth(folder) as bench:
        yield "explorer search", await time_operation(size, partial(bench.search, size))
        async for measured in _blocks(bench, size):
            yield measured


async def measure_members(folder: Path, size: int) -> Measured:
    yield "node start: ledger", await time_operation(size, partial(_start, folder))
    async with open_growth(folder) as bench:
        yield "admission of a call", await time_operation(size, bench.admit)
        async for measured in _blocks(bench, size):
            yield measured

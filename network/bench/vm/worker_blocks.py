"""Throughput of `records.record` through a worker, in CPU time of both processes."""

from __future__ import annotations

import asyncio
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from consensus.chain.genesis import Genesis, genesis_to_json
from consensus.chain.transaction import Transaction, sign_transaction
from consensus.limits import BLOCK_TRANSACTIONS_MAX_COUNT, SEALED_METADATA_BYTES, TIME_BUCKET_MS
from consensus.primitives.encoding import encode_value, u64
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.records.commitments import derive_record_id
from consensus.state import identity
from contracts.execution.results import BlockResult
from contracts.state.view import Overlay, StateView
from contracts.worker.wire import Begin
from contracts.worker.worker_machine import WorkerMachine, WorkerSpec
from network.sim.plan import NetworkSize
from network.sim.world.sim_chain import make_chain
from node.execution.block_executor import genesis_block
from node.execution.sandboxed_contracts import WORKER_COMMAND, WORKER_MEMORY_MAX_BYTES, WorkerLedgerSource
from node.storage.ledger_store import FinalizedBlock
from node.storage.lmdb_store import LmdbStore

_WARM_UP_BLOCKS_COUNT = 3
_NOW_MS = TIME_BUCKET_MS * 10_000_000
_ROBOT = PrivateKey(sha256(b"robot of the bench"))
_OWNER = PrivateKey(sha256(b"owner of the bench"))
_PURPOSE = "bench"


def _processor_s(pid: int) -> float:
    try:
        return time.thread_time() + time.clock_gettime(~pid << 3 | 2)  # the kernel's number of that process's clock
    except OSError:
        return time.perf_counter()


class BlockBench:
    """A robot with an open visit on its own ledger, and a worker."""

    def __init__(self, folder: Path) -> None:
        self._genesis: Genesis = make_chain(NetworkSize(1, 1)).genesis
        self._folder = folder
        self._store = LmdbStore.create(folder)
        self._height = 0
        self._count = 0
        self._calls_a_block = BLOCK_TRANSACTIONS_MAX_COUNT

    async def run(self, seconds: float) -> tuple[int, float]:
        await self._store.commit([genesis_block(self._genesis)], b"")
        await self._prepare_state()
        begin = Begin(genesis_to_json(self._genesis), str(self._folder), WORKER_MEMORY_MAX_BYTES)
        machine = WorkerMachine(WorkerSpec(WORKER_COMMAND, begin), WorkerLedgerSource(self._store))
        try:
            machine.greet()
            await self._block(
                machine, [self._sign("open_visit", [_OWNER.public_key, b"\2" * 33, 7, _NOW_MS, _PURPOSE])]
            )
            self._calls_a_block = self._find_calls_a_block(machine)
            for _ in range(_WARM_UP_BLOCKS_COUNT):
                await self._block(machine, self._records())
            calls, spent_s = 0, 0.0
            while spent_s < seconds:
                transactions = self._records()
                spent_s += await self._block(machine, transactions)
                calls += len(transactions)
            return calls, spent_s
        finally:
            machine.close()
            await self._store.close()

    async def _prepare_state(self) -> None:
        text = {"role": "robot", "org": "bench", "status": "active"}
        robot = {"handle": b"h" * 32, **text, "since": _NOW_MS}
        with self._store.snapshot() as parent:
            made = Overlay.apply(
                parent,
                {
                    identity.MEMBER.key(_ROBOT.public_key): encode_value(robot),
                    identity.PURPOSE.key(_PURPOSE): encode_value(True),
                },
            )
            await self._commit(made.state_root, made.writes, made.page_writes)

    def _sign(self, entry: str, arguments: list[Any]) -> Transaction:
        self._count += 1
        return sign_transaction(
            _ROBOT,
            chain_id=self._genesis.chain_id,
            contract="records",
            entry=entry,
            arguments=arguments,
            valid_until_ms=_NOW_MS + 600_000,
            salt=u64(self._count),
        )

    def _records(self) -> list[Transaction]:
        return [self._record() for _ in range(self._calls_a_block)]

    def _record(self) -> Transaction:
        owner, root, metadata = _OWNER.public_key, sha256(u64(self._count)), b"m" * SEALED_METADATA_BYTES
        arguments = [derive_record_id(owner, root), owner, root, b"2" * 32, metadata, _NOW_MS, _NOW_MS + 1_000_000]
        return self._sign("record", arguments)

    def _find_calls_a_block(self, machine: WorkerMachine) -> int:
        with self._store.snapshot() as parent:
            result, _ = machine.build(parent, self._height + 1, _NOW_MS + self._height + 1, self._records())
        return len(result.receipts)

    async def _block(self, machine: WorkerMachine, transactions: list[Transaction]) -> float:
        pid = int(machine.describe()["pid"])
        with self._store.snapshot() as parent:
            started_s = _processor_s(pid)
            result = machine.verify(parent, self._height + 1, _NOW_MS + self._height + 1, transactions)
            spent_s = _processor_s(pid) - started_s
            _require_good(parent, result)
        await self._commit(result.state_root, result.writes, result.page_writes)
        return spent_s

    async def _commit(
        self, root: bytes, writes: Mapping[bytes, bytes | None], pages: Mapping[bytes, bytes | None]
    ) -> None:
        self._height += 1
        block = FinalizedBlock(
            height=self._height,
            block_id=sha256(u64(self._height)),
            block_bytes=b"",
            receipts_bytes=b"",
            timestamp_ms=_NOW_MS + self._height,
            state_root=root,
            state_writes=writes,
            page_writes=pages,
        )
        await self._store.commit([block], b"")


def _require_good(parent: StateView, result: BlockResult) -> None:
    bad = [receipt for receipt in result.receipts if not receipt.ok]
    if bad or result.state_root == parent.state_root:
        raise RuntimeError(f"records failed: {bad[0].code}: {bad[0].message}" if bad else "the block changed nothing")


def measure_block_calls_per_s(seconds: float) -> float:
    with tempfile.TemporaryDirectory() as folder:
        calls, spent_s = asyncio.run(BlockBench(Path(folder) / "ledger").run(seconds))
    return calls / spent_s

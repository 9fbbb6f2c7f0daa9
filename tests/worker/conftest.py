"""A chain on disk, and worker processes that execute its blocks: real processes, real sandboxes."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from consensus.chain.genesis import genesis_to_json
from contracts.worker.wire import Begin
from contracts.worker.worker_machine import WorkerMachine, WorkerSpec
from node.execution.block_executor import genesis_block
from node.execution.sandboxed_contracts import WORKER_COMMAND, WorkerLedgerSource
from node.storage.lmdb_store import LmdbStore
from tests.worker.written_blocks import Chain

MEMORY_MAX_BYTES = 512 * 1024**2

Start = Callable[..., WorkerMachine]


@pytest.fixture
async def chain(tmp_path: Path) -> AsyncIterator[Chain]:
    store = LmdbStore.create(tmp_path / "ledger")
    chain = Chain(store)
    await store.commit([genesis_block(chain.genesis)], b"")
    try:
        yield chain
    finally:
        chain.close()
        await store.close()


@pytest.fixture
def lost() -> list[str]:
    """Why workers were replaced, in order."""
    return []


@pytest.fixture
def staff(chain: Chain, tmp_path: Path, lost: list[str]) -> WorkerSpec:
    begin = Begin(genesis_to_json(chain.genesis), str(tmp_path / "ledger"), MEMORY_MAX_BYTES)
    return WorkerSpec(WORKER_COMMAND, begin, lost.append)


@pytest.fixture
def start(chain: Chain, staff: WorkerSpec) -> Iterator[Start]:
    """Start a machine with a worker in its sandbox; what is given replaces parts of how it is started."""
    machines: list[WorkerMachine] = []

    def start_machine(**changes: Any) -> WorkerMachine:
        machine = WorkerMachine(replace(staff, **changes), WorkerLedgerSource(chain.store))
        machines.append(machine)
        machine.greet()
        return machine

    yield start_machine
    for machine in machines:
        machine.close()

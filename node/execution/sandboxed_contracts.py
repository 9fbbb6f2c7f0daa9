"""Where a node's contracts run: in sandboxed workers (blocks, views) or the node."""

from __future__ import annotations

import asyncio
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Any, Protocol

import structlog

from consensus.chain.genesis import Genesis, genesis_to_json
from consensus.errors import BlockRobotError
from contracts.execution.contract_machine import ContractMachine
from contracts.execution.views import ContractViews
from contracts.lifecycle.registry import check_contracts
from contracts.worker.wire import Begin, SandboxFeature
from contracts.worker.worker_machine import Hold, WorkerMachine, WorkerSpec, WorkerViews, missing_parts
from node.config import CONTRACT_MEMORY_MIB, NodeConfig
from node.execution.execution_machines import Machine, ViewRunner
from node.limits.token_buckets import OWN, Source, over_budget
from node.storage.ledger_store import LedgerStore
from node.storage.ledger_view import LedgerView
from node.storage.lmdb_reader import LedgerFile

VIEWS_WAITING_MAX_COUNT = 64


VIEWS_OF_SOURCE_MAX_COUNT = 8
"""Of a session, of the visit keys at one address, or of this node itself."""


VIEWS_OF_VISIT_KEY_MAX_COUNT = 2


class ViewPlaces:
    """The views that run or wait."""

    def __init__(self) -> None:
        self._taken: Counter[Source] = Counter()
        self._count = 0

    def take(self, source: Source) -> None:
        """Raises RATE_LIMITED for the source's share, VIEWS_BUSY for the total."""
        is_over_part = bool(source.part) and self._taken[source] >= VIEWS_OF_VISIT_KEY_MAX_COUNT
        if is_over_part or self._taken[source.shared] >= VIEWS_OF_SOURCE_MAX_COUNT:
            raise over_budget(str(source), 1.0)
        if self._count >= VIEWS_WAITING_MAX_COUNT:
            raise BlockRobotError("VIEWS_BUSY")
        self._add(source, 1)

    def give_back(self, source: Source) -> None:
        self._add(source, -1)

    def _add(self, source: Source, count: int) -> None:
        self._count += count
        for each in dict.fromkeys((source, source.shared)):
            self._taken[each] += count
            if not self._taken[each]:
                del self._taken[each]


WORKER_COMMAND = (sys.executable, "-I", "-m", "node.execution.contract_worker")
_BYTES_PER_MIB = 1024**2
WORKER_MEMORY_MAX_BYTES = CONTRACT_MEMORY_MIB * _BYTES_PER_MIB

log = structlog.get_logger(__name__)


class ContractRuntime(Protocol):
    """Where contracts run."""

    @property
    def machine(self) -> Machine | None: ...

    @property
    def views(self) -> ViewRunner: ...

    def describe(self) -> Mapping[str, Any]: ...

    async def close(self) -> None: ...


class WorkerLedgerSource:
    """The node's ledger as `contracts.worker` needs it."""

    def __init__(self, ledger: LedgerStore) -> None:
        self._ledger = ledger

    def height(self) -> int:
        position = self._ledger.position
        return -1 if position is None else position.height

    def hold(self) -> Hold:
        return self._ledger.snapshot()


class _FileOfWorkers:
    def __init__(self, ledger: LedgerFile) -> None:
        self._ledger = ledger

    def height(self) -> int:
        with self._ledger.snapshot() as ledger:
            return -1 if ledger.position is None else ledger.position.height

    def hold(self) -> Hold:
        return self._ledger.snapshot()


@contextmanager
def open_sandboxed_machine(config: NodeConfig, genesis: Genesis, ledger: LedgerFile) -> Iterator[Machine]:
    """Yield a tool's machine on a node's ledger, sandboxed like the node.

    Raises CONTRACT_WORKER_FAILED, CONTRACT_SANDBOX_INCOMPLETE, GENESIS_INVALID.
    """
    if config.contract_sandbox == "off":
        yield ContractMachine.of_genesis(genesis)
        return
    check_contracts(genesis)
    machine = WorkerMachine(WorkerSpec(WORKER_COMMAND, _begin(config, genesis)), _FileOfWorkers(ledger))
    try:
        _require_sandbox(config.contract_sandbox, machine.greet())
        yield machine
    finally:
        machine.close()


def _begin(config: NodeConfig, genesis: Genesis) -> Begin:
    return Begin(genesis_to_json(genesis), str(config.ledger_dir), config.contract_memory_mib * _BYTES_PER_MIB)


def _require_sandbox(mode: str, parts: tuple[SandboxFeature, ...]) -> None:
    """Raises CONTRACT_SANDBOX_INCOMPLETE."""
    missing = missing_parts(parts)
    if mode == "require" and missing:
        named = "; ".join(f"{name}: {why}" for name, why in missing.items())
        raise BlockRobotError("CONTRACT_SANDBOX_INCOMPLETE", f"The sandbox of contracts lacks {named}.")


class InProcessContracts:
    """Contracts run inside the node's process."""

    machine: Machine | None = None

    def __init__(self, genesis: Genesis) -> None:
        """Raises GENESIS_INVALID."""
        self._views = ContractViews(genesis)
        self.views: ViewRunner = self

    async def run_view(
        self,
        snapshot: LedgerView,
        contract: str,
        view: str,
        arguments: list[Any],
        source: Source = OWN,  # noqa: ARG002 - they run at once
    ) -> bytes:
        header = snapshot.header
        return self._views.run(snapshot, header.height, header.timestamp_ms, contract, view, arguments)

    def describe(self) -> Mapping[str, Any]:
        return {"sandbox": "off"}

    async def close(self) -> None: ...


class SandboxedContracts:
    """Contracts run in two worker processes: one for blocks, one for views."""

    def __init__(self, mode: str, staff: WorkerSpec, ledger: LedgerStore) -> None:
        """Start the block worker without waiting; the first view starts the other."""
        self._mode = mode
        blocks = replace(staff, note_loss=partial(_note_loss, "blocks"))
        self._blocks = WorkerMachine(blocks, WorkerLedgerSource(ledger))
        self._views = WorkerViews(replace(staff, note_loss=partial(_note_loss, "views")))
        self._thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="views")
        self._places = ViewPlaces()
        self.machine: Machine | None = self._blocks
        self.views: ViewRunner = self

    async def greet(self) -> None:
        """Wait until the worker is sandboxed. Raises CONTRACT_WORKER_FAILED, CONTRACT_SANDBOX_INCOMPLETE."""
        parts = await asyncio.to_thread(self._blocks.greet)
        _report(parts)
        _require_sandbox(self._mode, parts)

    async def run_view(
        self, snapshot: LedgerView, contract: str, view: str, arguments: list[Any], source: Source = OWN
    ) -> bytes:
        """See `ViewRunner`; also raises RATE_LIMITED, VIEWS_BUSY, CONTRACT_WORKER_FAILED."""
        header = snapshot.header
        run = partial(
            self._views.run_view,
            snapshot,
            header.state_root,
            header.height,
            header.timestamp_ms,
            contract,
            view,
            arguments,
        )
        self._places.take(source)
        running = asyncio.get_running_loop().run_in_executor(self._thread, run)
        running.add_done_callback(lambda _running: self._places.give_back(source))
        return await _see_through(running)

    def describe(self) -> Mapping[str, Any]:
        return {"sandbox": self._mode, "blocks": self._blocks.describe(), "views": self._views.describe()}

    async def close(self) -> None:
        await asyncio.to_thread(self._close)

    def _close(self) -> None:
        self._blocks.close()
        self._views.close()
        self._thread.shutdown(wait=True)


async def _see_through(running: asyncio.Future[bytes]) -> bytes:
    """Wait for the thread even if cancelled: it reads the caller's snapshot."""
    try:
        return await asyncio.shield(running)
    except asyncio.CancelledError:
        await asyncio.wait([running])
        raise


def _note_loss(what: str, reason: str) -> None:
    log.warning("contract_worker_replaced", worker=what, reason=reason)


def _report(parts: tuple[SandboxFeature, ...]) -> None:
    missing = {part.name: part.detail for part in parts if not part.had}
    log.info("contract_sandbox_entered", parts=[part.name for part in parts if part.had])
    if missing:
        log.warning("contract_sandbox_incomplete", missing=missing)


async def open_contracts(config: NodeConfig, genesis: Genesis, ledger: LedgerStore) -> ContractRuntime:
    """The ledger holds genesis.

    Raises CONTRACT_WORKER_FAILED, CONTRACT_SANDBOX_INCOMPLETE, GENESIS_INVALID.
    """
    if config.contract_sandbox == "off":
        log.warning("contract_sandbox_off")
        return InProcessContracts(genesis)
    check_contracts(genesis)  # said here: a worker that cannot begin only ends
    place = SandboxedContracts(config.contract_sandbox, WorkerSpec(WORKER_COMMAND, _begin(config, genesis)), ledger)
    try:
        await place.greet()
    except BaseException:
        await place.close()
        raise
    return place

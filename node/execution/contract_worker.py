"""`python -I -m node.execution.contract_worker`: runs contracts for a node, sandboxed, until its pipe ends."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from consensus.chain.genesis import genesis_from_json
from contracts.execution.contract_machine import ContractMachine
from contracts.execution.views import ContractViews
from contracts.worker.process import WorkerTools, serve
from contracts.worker.wire import Begin, Pipe
from node.storage.lmdb_reader import LedgerFile
from node.storage.lmdb_snapshot import LmdbSnapshot
from node.storage.lmdb_store import DATA_FILE_NAME


class WorkerLedger:
    """The ledger at one position, for the worker; see `contracts.worker.process.LedgerView`."""

    def __init__(self, snapshot: LmdbSnapshot) -> None:
        self._snapshot = snapshot
        self.get: Callable[[bytes], bytes | None] = snapshot.get
        self.page: Callable[[bytes], bytes | None] = snapshot.page
        self.state_root = snapshot.state_root
        position = snapshot.position
        self.height = -1 if position is None else position.height

    def scan(self, prefix: bytes, limit: int) -> Iterator[tuple[bytes, bytes]]:
        return self._snapshot.scan(prefix, limit)

    def scan_range(self, start: bytes, end: bytes) -> Iterator[tuple[bytes, bytes]]:
        return self._snapshot.scan_range(start, end)

    def close(self) -> None:
        del self.get, self.page
        self._snapshot.close()


def prepare(begin: Begin) -> WorkerTools:
    """Raises GENESIS_INVALID, DATA_DIRECTORY_INVALID, STORAGE_DAMAGED."""
    genesis = genesis_from_json(begin.genesis_json)
    directory = Path(begin.ledger_dir)
    ledger = LedgerFile(directory, held=True)
    views = ContractViews(genesis)
    with ledger.snapshot() as snapshot:
        views.load(snapshot)
    return WorkerTools(
        machine=ContractMachine.of_genesis(genesis),
        run_view=views.run,
        open_ledger=lambda: WorkerLedger(ledger.snapshot()),
        kept_files=(directory / DATA_FILE_NAME,),
    )


def main(prepare_place: Callable[[Begin], WorkerTools] = prepare) -> int:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal says it to everybody; the node is who decides
    os.umask(0o077)
    serve(Pipe(0, 1), prepare_place)
    return 0


if __name__ == "__main__":
    sys.exit(main())

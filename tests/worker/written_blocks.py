"""Blocks of registrations, executed inside the test too: what a worker says is held against that."""

from __future__ import annotations

from collections.abc import Sequence

from consensus.chain.block import Receipts
from consensus.chain.transaction import Transaction
from consensus.primitives.encoding import encode
from consensus.primitives.hashing import sha256
from contracts.execution.contract_machine import ContractMachine
from contracts.execution.results import BlockResult, ExpectedBlock
from contracts.state.view import Overlay, StateView
from contracts.worker.worker_machine import WorkerMachine
from node.storage.ledger_store import FinalizedBlock
from node.storage.lmdb_store import LmdbStore
from tests.unit.contracts.privacy.hospital import START_MS, Hospital, Person


class Chain:
    """A ledger with genesis, and one branch above it: `view` is the state after its newest block."""

    def __init__(self, store: LmdbStore) -> None:
        self.store = store
        self.hospital = Hospital()
        self.genesis = self.hospital.genesis
        self.inside = ContractMachine.of_genesis(self.genesis)
        self.height = 0
        self._snapshot = None
        self._above: list[tuple[int, BlockResult]] = []
        self._people = 0

    @property
    def view(self) -> StateView:
        """The state of the newest block: what waits to be stored, over a snapshot."""
        if self._snapshot is None:
            self._snapshot = self.store.snapshot()
        view: StateView = self._snapshot
        for _, result in self._above:
            view = Overlay(view, result.writes, result.page_writes, result.state_root)
        return view

    def registrations(self, count: int = 2) -> list[Transaction]:
        """Return transactions that each enrol another person."""
        found = []
        for _ in range(count):
            self._people += 1
            person = Person(f"person-{self._people}")
            arguments = self.hospital.register_arguments(person, self.hospital.card(person.name))
            found.append(self.hospital.sign(person.identity, "identity", "register", *arguments))
        return found

    def time_ms(self, height: int) -> int:
        return START_MS + 100 * height

    def check(
        self, machine: WorkerMachine, transactions: Sequence[Transaction], parent: StateView | None = None
    ) -> None:
        """Verify a block in the worker, on the newest one or another; it must come out as it does inside."""
        parent = self.view if parent is None else parent
        place = (parent, self.height + 1, self.time_ms(self.height + 1), transactions)
        assert machine.verify(*place) == self.inside.verify(*place)

    def add(self, machine: WorkerMachine, count: int = 2) -> None:
        """Put a block on the branch that both executed alike."""
        transactions = self.registrations(count)
        place = (self.view, self.height + 1, self.time_ms(self.height + 1), transactions)
        result = machine.verify(*place)
        assert result == self.inside.verify(*place)
        assert all(receipt.ok for receipt in result.receipts)
        self.put(result)

    def run(self, count: int) -> tuple[list[ExpectedBlock], list[BlockResult]]:
        """Put blocks on the branch that only this process executed; return them and what they gave."""
        blocks, results = [], []
        for _ in range(count):
            number, transactions = self.height + 1, self.registrations()
            result = self.inside.verify(self.view, number, self.time_ms(number), transactions)
            blocks.append(ExpectedBlock(number, self.time_ms(number), transactions, result.state_root))
            results.append(result)
            self.put(result)
        return blocks, results

    def put(self, result: BlockResult) -> None:
        """Put what a block gave on the branch."""
        self.height += 1
        self._above.append((self.height, result))

    async def store_up_to(self, height: int) -> None:
        """Store the oldest blocks of the branch; its views stand on the old snapshot until `rebase`."""
        blocks = [self._to_store(number, result) for number, result in self._above if number <= height]
        await self.store.commit([block for block in blocks if block.height > self.store.position.height], b"")

    def rebase(self) -> None:
        """Stand on the newest stored block."""
        self.close()
        self._above = [item for item in self._above if item[0] > self.store.position.height]

    def _to_store(self, height: int, result: BlockResult) -> FinalizedBlock:
        return FinalizedBlock(
            height=height,
            block_id=sha256(b"block" + height.to_bytes(4, "big")),
            block_bytes=b"block",
            receipts_bytes=encode(Receipts(result.receipts)),
            timestamp_ms=self.time_ms(height),
            state_root=result.state_root,
            state_writes=result.writes,
            page_writes=result.page_writes,
        )

    def close(self) -> None:
        if self._snapshot is not None:
            self._snapshot.close()
            self._snapshot = None

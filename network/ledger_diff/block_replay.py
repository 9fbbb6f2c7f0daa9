"""Re-executes finalized blocks to find which transaction wrote a key."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from consensus.chain.block import Block, Header
from consensus.chain.genesis import Genesis
from consensus.chain.transaction import Transaction, decode_transaction
from consensus.errors import BlockRobotError
from contracts.execution.genesis import open_genesis
from contracts.state.view import MemoryState, Overlay, StateView
from node.execution.execution_machines import Machine
from node.snapshot.checking import restore_into
from node.snapshot.snapshot_format import SnapshotSource
from node.storage.memory_store import MemoryRestore


@dataclass(frozen=True, slots=True)
class Writer:
    """A key's last writer: block and transaction (None: the block itself)."""

    height: int
    block_id: bytes
    transaction: Transaction | None


@dataclass(slots=True)
class Base:
    """A trusted state and the block it follows."""

    state: MemoryState
    height: int
    block_id: bytes


def base_of_genesis(genesis: Genesis) -> Base:
    """Raises GENESIS_INVALID."""
    opened = open_genesis(genesis)
    state = MemoryState()
    state.absorb(opened.writes, opened.pages, opened.state_root)
    return Base(state, 0, genesis.block_id)


def base_of_snapshot(source: SnapshotSource, genesis: Genesis) -> Base:
    """In memory, verified from genesis. Raises SNAPSHOT_*."""
    restore = MemoryRestore()
    head = restore_into(source, genesis, restore)
    state = MemoryState()
    if restore.store is not None:
        with restore.store.snapshot() as ledger:
            state.apply(dict(ledger.scan(b"", head.manifest.state_row_count + 1)))
    return Base(state, head.header.height, head.block.block_id)


def execute_on(machine: Machine, parent: StateView, block: Block) -> tuple[Overlay, bool]:
    """Return its state and whether the root matches."""
    header = block.header
    transactions = [decode_transaction(wire) for wire in block.transactions]
    gives_up = header.gives_up_change
    result = machine.verify(parent, header.height, header.timestamp_ms, transactions, gives_up_change=gives_up)
    overlay = Overlay(parent, result.writes, result.page_writes, result.state_root)
    return overlay, result.state_root == header.state_root


class Replay:
    """Replays blocks from a base and tracks the requested keys' writers."""

    def __init__(self, machine: Machine, base: Base, keys: Iterable[bytes] = ()) -> None:
        self._machine = machine
        self._base = base
        self._keys = frozenset(keys)
        self.writers: dict[bytes, Writer] = {}

    @property
    def height(self) -> int:
        return self._base.height

    @property
    def state(self) -> MemoryState:
        return self._base.state

    def run(self, read: Callable[[int], Block | None], until: int, progress: Callable[[int], None]) -> None:
        """Blocks come from `read`.

        Raises BLOCK_PRUNED if one is missing, BLOCK_INVALID if unlinked or with another root.
        """
        while self._base.height < until:
            height = self._base.height + 1
            block = read(height)
            if block is None:
                raise BlockRobotError("BLOCK_PRUNED", f"No node here holds the body of block {height}.")
            self.take(block)
            progress(height)

    def take(self, block: Block) -> None:
        """Raises BLOCK_INVALID."""
        header = block.header
        if header.parent_id != self._base.block_id:
            raise BlockRobotError("BLOCK_INVALID", f"Block {header.height} does not follow the one replayed before it.")
        overlay, is_equal = execute_on(self._machine, self._base.state, block)
        if not is_equal:
            raise BlockRobotError("BLOCK_INVALID", f"Executed here, block {header.height} gives another state root.")
        touched = self._keys & overlay.writes.keys()
        if touched:
            self.writers |= find_writers(self._machine, self._base.state, block, touched)
        self._base.state.absorb(overlay.writes, overlay.page_writes, overlay.state_root)
        self._base.height, self._base.block_id = header.height, block.block_id


def find_writers(machine: Machine, parent: StateView, block: Block, keys: Iterable[bytes]) -> dict[bytes, Writer]:
    """Executes one transaction at a time."""
    header: Header = block.header
    found = {key: Writer(header.height, block.block_id, None) for key in sorted(keys)}
    view, gives_up = parent, header.gives_up_change
    for wire in block.transactions:
        transaction = decode_transaction(wire)
        result = machine.verify(view, header.height, header.timestamp_ms, [transaction], gives_up_change=gives_up)
        gives_up = False  # it is done with the first
        for key in [key for key in found if key in result.writes]:
            found[key] = Writer(header.height, block.block_id, transaction)
        view = Overlay(view, result.writes, result.page_writes, result.state_root)
    return found

"""A few whole nodes in one process: memory instead of disks and links, virtual time, the real contracts.

For tests of what several nodes do together; faults and long histories are the simulator's.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from typing import Any

from consensus.chain.genesis import ChainSettings, Genesis, NodeEntry, Organisation
from consensus.chain.signature_cache import SignatureCache
from consensus.chain.transaction import Transaction, sign_transaction
from consensus.errors import BlockRobotError
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from contracts.execution.genesis import complete_genesis
from contracts.lifecycle.registry import contract_entries
from node.components import Environment, NodeComponents, begin_ledger
from node.consensus.journal import JournalEntry
from node.execution.execution_machines import Machine
from node.mempool.transaction_cache import TransactionCache
from node.p2p.network import PeerHandler
from node.p2p.wire import FrameKind, RequestKind
from node.storage.memory_store import MemoryStore
from tests.virtual_time import virtual_now_ms

ADMIN = PrivateKey(sha256(b"an admin"))
LINK_DELAY_S = 0.002
START_MS = 1_700_000_000_000


def producer_key(name: str) -> PrivateKey:
    return PrivateKey(sha256(b"producer " + name.encode()))


def make_genesis(names: list[str], followers: list[str] = [], **settings: Any) -> Genesis:  # noqa: B006 - read only
    """One organisation, whose admin alone decides, with these producers and followers."""
    nodes = tuple(
        NodeEntry(name, "hospital", "127.0.0.1", 1 + place, "", key, b"", b"")
        for place, name in enumerate([*names, *followers])
        for key in [producer_key(name).public_key if name in names else b""]
    )
    organisation = Organisation("hospital", "certificate", (ADMIN.public_key,), ())
    entries = contract_entries()
    genesis = Genesis(1, "test", START_MS, ChainSettings(**settings), (organisation,), nodes, entries, (), b"")
    return complete_genesis(genesis)


class MemoryJournal:
    """A voting journal that survives its node."""

    def __init__(self) -> None:
        self.records: list[tuple[int, bytes]] = []
        self.size_bytes = 0

    @property
    def entries(self) -> tuple[JournalEntry, ...]:
        return tuple(JournalEntry(place, kind, record) for place, (kind, record) in enumerate(self.records, start=1))

    def append(self, record: bytes, kind: int = 0) -> int:
        self.records.append((kind, record))
        return len(self.records)

    def sync(self) -> int:
        return len(self.records)

    def compact(self, keep: Iterable[tuple[int, bytes]], *, through: int | None = None) -> None:
        self.records = list(keep)

    def recover(self, keep: Iterable[tuple[int, bytes]]) -> None:
        self.records = list(keep)


class _Clock:
    def now_ms(self) -> int:
        return virtual_now_ms()


class MemoryLinks:
    """The links of one node: to all that run and are not cut off."""

    def __init__(self, crowd: SmallNodes, name: str, handler: PeerHandler) -> None:
        self._crowd = crowd
        self.name = name
        self.handler = handler
        self.sent: list[tuple[str, FrameKind, bytes]] = []
        self.cut: list[tuple[str, str]] = []

    @property
    def connected(self) -> list[str]:
        return sorted(name for name in self._crowd.links if self._reaches(name))

    def _reaches(self, name: str) -> bool:
        cut = self._crowd.cut_off
        return name != self.name and name in self._crowd.links and name not in cut and self.name not in cut

    async def start(self) -> None:
        self._crowd.links[self.name] = self
        asyncio.get_running_loop().call_later(LINK_DELAY_S, self.greet)

    def greet(self) -> None:
        for name in self.connected:
            other = self._crowd.links[name]
            self.handler.peer_connected(name, other.handler.finalized_height())
            other.handler.peer_connected(self.name, self.handler.finalized_height())

    async def stop(self) -> None:
        del self._crowd.links[self.name]

    def broadcast(self, kind: FrameKind, payload: bytes) -> None:
        for name in self.connected:
            self.send(name, kind, payload)

    def send(self, peer: str, kind: FrameKind, payload: bytes) -> bool:
        if not self._reaches(peer):
            return False
        self.sent.append((peer, kind, payload))
        asyncio.get_running_loop().call_later(LINK_DELAY_S, self._deliver, peer, kind, payload)
        return True

    def _deliver(self, peer: str, kind: FrameKind, payload: bytes) -> None:
        if self._reaches(peer):
            self._crowd.links[peer].handler.peer_frame(self.name, kind, payload)

    def cut_off(self, peer: str, error: BlockRobotError) -> None:
        self.cut.append((peer, error.code))

    async def request(self, peer: str, kind: RequestKind, body: bytes) -> bytes:
        await asyncio.sleep(LINK_DELAY_S)
        if not self._reaches(peer):
            raise BlockRobotError("PEER_UNAVAILABLE")
        return await self._crowd.links[peer].handler.peer_request(self.name, kind, body)


class SmallNodes:
    """The nodes of a genesis. Use inside of `run_virtual`."""

    def __init__(self, genesis: Genesis) -> None:
        self.genesis = genesis
        self.links: dict[str, MemoryLinks] = {}
        self.cut_off: set[str] = set()
        self.nodes: dict[str, NodeComponents] = {}
        self.ledgers = {node.name: MemoryStore() for node in genesis.nodes}
        self.journals = {node.name: MemoryJournal() for node in genesis.nodes}
        self.machines: dict[str, Machine] = {}
        self._check = SignatureCache()
        self._transactions = TransactionCache()
        self._salt = 0

    async def start(self, *names: str) -> SmallNodes:
        """Start these nodes, or all; return itself."""
        for name in names or tuple(self.ledgers):
            await begin_ledger(self.ledgers[name], self.genesis)
            node = NodeComponents(
                Environment(
                    genesis=self.genesis,
                    name=name,
                    ledger=self.ledgers[name],
                    journal=self.journals[name],
                    clock=_Clock(),
                    open_network=lambda handler, name=name: MemoryLinks(self, name, handler),  # type: ignore[misc]
                    key=producer_key(name),
                    stopwatch=asyncio.get_running_loop().time,
                    check=self._check,
                    transactions=self._transactions,
                    machine=self.machines.get(name),
                )
            )
            self.nodes[name] = node
            await node.start()
        return self

    async def stop(self, *names: str) -> None:
        """Stop these nodes, or all."""
        for name in names or tuple(self.nodes):
            await self.nodes.pop(name).stop()

    def heal(self) -> None:
        """Let those that were cut off come back."""
        back, self.cut_off = self.cut_off, set()
        for name in sorted(back & self.links.keys()):
            self.links[name].greet()

    def transaction(self, contract: str, entry: str, *arguments: Any, key: PrivateKey = ADMIN) -> Transaction:
        self._salt += 1
        return sign_transaction(
            key,
            chain_id=self.genesis.chain_id,
            contract=contract,
            entry=entry,
            arguments=list(arguments),
            valid_until_ms=virtual_now_ms() + 300_000,
            salt=self._salt.to_bytes(8),
        )

    async def finalize(self, node: str, transaction: Transaction, timeout_ms: int = 60_000) -> None:
        """Submit to one node and wait until the transaction is final there."""
        (result,) = await self.nodes[node].pool.submit([transaction.wire])
        assert result.error is None, result.error
        assert await self.nodes[node].pool.wait_final(transaction.txid, timeout_ms)

    async def wait_epoch(self, number: int, *names: str, timeout_s: float = 60.0) -> None:
        """Wait until these nodes (or all) are in an epoch."""
        async with asyncio.timeout(timeout_s):
            while any(self.nodes[name].core.epoch < number for name in names or self.nodes):  # noqa: ASYNC110
                await asyncio.sleep(0.01)

    async def wait_height(self, height: int, *names: str, timeout_s: float = 60.0) -> None:
        """Wait until these nodes (or all) have stored a height."""
        async with asyncio.timeout(timeout_s):
            while any(self.nodes[name].feed.height < height for name in names or self.nodes):  # noqa: ASYNC110
                await asyncio.sleep(0.01)

    def newest_common(self) -> set[bytes]:
        """The ids of the blocks at the lowest height that all nodes have: one, if they agree."""
        height = min(node.feed.height for node in self.nodes.values())
        found = set()
        for node in self.nodes.values():
            with node.finalized.snapshot() as snapshot:
                block = snapshot.block(height)
                assert block is not None
                found.add(block.block_id)
        return found

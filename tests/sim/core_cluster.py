"""Production cores of n nodes on a virtual clock, network and disk: one seed, one history.

What is faked is the outside only: an executor that hashes transactions, a journal whose records are safe once synced, a
store that syncs later, links that delay, lose, double and cut. Every promise that a node sends is checked as it leaves.
"""

from __future__ import annotations

import heapq
import random
from collections.abc import Callable
from dataclasses import dataclass, field

from consensus.chain.block import genesis_certificate
from consensus.chain.evidence import Evidence
from consensus.chain.genesis import ChainSettings
from consensus.chain.schedule import Epoch
from consensus.chain.signature_cache import SignatureCache
from tests.sim.core_checks import Violations
from tests.sim.core_node import SimNode
from tests.sim.named_chain import EPOCH_START_MS, make_change, make_genesis_block, make_keys, make_transaction, txid_of


@dataclass
class Links:
    """How the network behaves. Delays are in ms."""

    delay_min: float = 5
    delay_max: float = 50
    loss: float = 0.0
    duplicates: float = 0.0
    groups: list[set[int]] = field(default_factory=list)

    def connects(self, first: int, second: int) -> bool:
        return not self.groups or any(first in group and second in group for group in self.groups)


class Cluster:
    """n producers, those that may become some, and followers; one virtual clock, one source of chance."""

    def __init__(
        self,
        count: int = 4,
        seed: int = 0,
        settings: ChainSettings | None = None,
        followers: int = 0,
        *,
        candidates: int = 0,
        kinds: dict[int, type[SimNode]] | None = None,
    ) -> None:
        """`kinds` says which nodes are of another class than `SimNode`."""
        self.count = count
        self.random = random.Random(seed)
        self.settings = settings or ChainSettings()
        self.keys = make_keys(count + candidates)
        self._number_of = {key.public_key: number for number, key in enumerate(self.keys)}
        self.first_epoch = self.epoch_of(list(range(count)))
        self.genesis = make_genesis_block()
        self.genesis_qc = genesis_certificate(self.genesis.block_id)
        self.check = SignatureCache(1 << 20)
        self.links = Links()
        self.violations = Violations()
        self.halts: list[tuple[int, str]] = []
        self.evidence: list[tuple[int, Evidence]] = []
        self.clock = 0.0
        self.messages = 0
        self.syncs = 0
        self.execution_ms = 1.0
        self.crash_after_sync = 0.0
        self._heap: list[tuple[float, int, Callable[[], None]]] = []
        self._sequence = 0
        self._transactions = 0
        every = range(len(self.keys) + followers)
        self.nodes = [(kinds or {}).get(number, SimNode)(self, number) for number in every]

    @property
    def now_ms(self) -> int:
        return EPOCH_START_MS + int(self.clock)

    def number_of(self, public_key: bytes) -> int:
        """Return the number of the node that has this key."""
        return self._number_of[public_key]

    def epoch_of(
        self, producers: list[int], leaderless: tuple[int, ...] = (), settings: ChainSettings | None = None
    ) -> Epoch:
        """Return an epoch of these nodes; whoever decides it gives it its number."""
        keys = tuple(self.keys[number].public_key for number in producers)
        return Epoch(number=0, producers=keys, leaderless=leaderless, settings=settings or self.settings)

    def at(self, time: float, action: Callable[[], None]) -> None:
        self._sequence += 1
        heapq.heappush(self._heap, (time, self._sequence, action))

    def transmit(self, sender: int, receiver: int, action: Callable[[], None]) -> None:
        """Carry something over a link, as the links are when it leaves."""
        links = self.links
        if not links.connects(sender, receiver) or self.random.random() < links.loss:
            return
        for _ in range(2 if self.random.random() < links.duplicates else 1):
            self.at(self.clock + self.random.uniform(links.delay_min, links.delay_max), action)

    def reconnect(self, number: int) -> None:
        """A node came back: each of its connections comes up on both sides."""
        for peer in self.nodes:
            if peer.number != number and peer.is_up and self.links.connects(peer.number, number):
                peer.connected(number)
                self.nodes[number].connected(peer.number)

    def start(self) -> None:
        for node in self.nodes:
            node.start()

    def submit(self, nodes: list[int] | None = None) -> bytes:
        """Give a new transaction to these nodes (all that are up, unless said); return its txid."""
        self._transactions += 1
        return self.give(make_transaction(self._transactions), nodes)

    def change(
        self,
        producers: list[int],
        *,
        leaderless: tuple[int, ...] = (),
        settings: ChainSettings | None = None,
        nodes: list[int] | None = None,
    ) -> bytes:
        """Submit a transaction that makes these nodes the producers of the next epoch; return its txid."""
        self._transactions += 1
        return self.give(make_change(self._transactions, self.epoch_of(producers, leaderless, settings)), nodes)

    def give(self, wire: bytes, nodes: list[int] | None) -> bytes:
        for number in range(len(self.nodes)) if nodes is None else nodes:
            self.nodes[number].submit(wire)
        return txid_of(wire)

    def run(self, duration_ms: float, until: Callable[[], bool] | None = None) -> bool:
        """Let time pass; stop early when `until` holds. Return whether it does."""
        end = self.clock + duration_ms
        while self._heap and self._heap[0][0] <= end:
            if until is not None and until():
                return True
            self.clock, _, action = heapq.heappop(self._heap)
            action()
        if until is not None and until():
            return True
        self.clock = end
        return False

    def all_final(self, txids: list[bytes]) -> bool:
        """Tell whether every node is up and has finalized all of these."""
        return all(node.is_up and all(txid in node.final_txids for txid in txids) for node in self.nodes)

    def final_where_up(self, txid: bytes) -> bool:
        """Tell whether every node that is up has finalized this one."""
        return all(txid in node.final_txids for node in self.nodes if node.is_up)

    def run_until_final(self, duration_ms: float, txid: bytes) -> bool:
        """Let time pass until this transaction is final on every node that is up."""
        return self.run(duration_ms, lambda: self.final_where_up(txid))

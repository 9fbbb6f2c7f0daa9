"""A bounded tree of unfinalized blocks, with certificates and orphans."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum, auto

from consensus.chain.block import GENESIS_ROUND, Block, Header, QuorumCertificate
from consensus.chain.block_rules import is_fit_for_parent
from consensus.limits import ORPHAN_BLOCKS_MAX_COUNT, TREE_BLOCKS_MAX_COUNT


class Execution(Enum):
    """A block's execution state; FAILED says nothing about the block (R41)."""

    WAITING = auto()
    RUNNING = auto()
    VALID = auto()
    REFUSED = auto()
    FAILED = auto()


@dataclass(slots=True, eq=False)
class BlockNode:
    """A decoded block; `parent` is None for root and orphans, `withheld` forbids voting."""

    block: Block
    block_id: bytes
    header: Header
    arrived_ms: int
    execution: Execution = Execution.WAITING
    withheld: bool = False
    parent: BlockNode | None = None
    children: list[BlockNode] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class TwoChain:
    """A finalized block and its proving certified child of the next round."""

    final: BlockNode
    child: BlockNode
    child_qc: QuorumCertificate


def make_node(block: Block, now_ms: int) -> BlockNode:
    """Decode a block. Raises ENCODING_*."""
    return BlockNode(block=block, block_id=block.block_id, header=block.header, arrived_ms=now_ms)


class BlockTree:
    """Blocks above the finalized head (`root`), in its certificate's epoch."""

    def __init__(self, finalized: Block, finalized_qc: QuorumCertificate) -> None:
        self.epoch = finalized_qc.epoch
        self.root = make_node(finalized, 0)
        self.root.execution = Execution.VALID
        self.nodes: dict[bytes, BlockNode] = {self.root.block_id: self.root}
        self.orphans: dict[bytes, BlockNode] = {}
        self.certificates: dict[bytes, QuorumCertificate] = {finalized_qc.block_id: finalized_qc}
        self._first_of_round: dict[int, bytes] = {}

    @property
    def root_round(self) -> int:
        """Return the finalized head's round; 0 for an earlier epoch (R23)."""
        return self.root.header.round if self.root.header.epoch == self.epoch else GENESIS_ROUND

    @property
    def has_ended(self) -> bool:
        """Return whether the finalized head ends the epoch (R22)."""
        head = self.root.header
        return head.epoch > self.epoch or (head.epoch == self.epoch and head.is_boundary)

    def get(self, block_id: bytes) -> BlockNode | None:
        return self.nodes.get(block_id)

    def find(self, block_id: bytes) -> BlockNode | None:
        return self.nodes.get(block_id) or self.orphans.get(block_id)

    def may_add(self, block_id: bytes, header: Header) -> bool:
        if block_id in self.nodes or block_id in self.orphans:
            return False
        if header.round <= self.root_round or header.height <= self.root.header.height:
            return False
        if len(self.nodes) >= TREE_BLOCKS_MAX_COUNT:
            return False
        return block_id in self.certificates or self._first_of_round.get(header.round, block_id) == block_id

    def add(self, node: BlockNode) -> list[BlockNode]:
        """Add a block; return it and connected orphans, parents first ([] for an orphan)."""
        self._first_of_round.setdefault(node.header.round, node.block_id)
        if node.header.parent_id not in self.nodes:
            self._add_orphan(node)
            return []
        return self._connect(node)

    def _add_orphan(self, node: BlockNode) -> None:
        self.orphans[node.block_id] = node
        if len(self.orphans) > ORPHAN_BLOCKS_MAX_COUNT:
            highest = max(self.orphans.values(), key=lambda orphan: orphan.header.height)
            del self.orphans[highest.block_id]

    def _connect(self, first: BlockNode) -> list[BlockNode]:
        connected: list[BlockNode] = []
        waiting = [first]
        while waiting:
            node = waiting.pop()
            parent = self.nodes[node.header.parent_id]
            node.parent = parent
            parent.children.append(node)
            if not is_fit_for_parent(node.header, parent.header) or parent.execution is Execution.REFUSED:
                node.execution = Execution.REFUSED
            self.nodes[node.block_id] = node
            connected.append(node)
            ready = [orphan for orphan in self.orphans.values() if orphan.header.parent_id == node.block_id]
            for orphan in ready:
                del self.orphans[orphan.block_id]
            waiting.extend(ready)
        return connected

    def certify(self, qc: QuorumCertificate) -> bool:
        """Store a checked QC; return whether it is its block's first."""
        if qc.block_id in self.certificates or (qc.round <= self.root_round and qc.block_id not in self.nodes):
            return False
        if len(self.certificates) >= 2 * TREE_BLOCKS_MAX_COUNT:
            return False
        self.certificates[qc.block_id] = qc
        return True

    def branch(self, block_id: bytes) -> list[BlockNode] | None:
        """Return blocks above the root to this one, oldest first; None if unconnected."""
        node = self.nodes.get(block_id)
        if node is None:
            return None
        path: list[BlockNode] = []
        while node is not None and node is not self.root:
            path.append(node)
            node = node.parent
        path.reverse()
        return path

    def two_chains(self) -> list[TwoChain]:
        """Return executed blocks final by the two-chain rule (R8), oldest first."""
        found: list[TwoChain] = []
        for node in self.nodes.values():
            parent = node.parent
            if parent is None or parent is self.root or parent.execution is not Execution.VALID:
                continue
            qc = self.certificates.get(node.block_id)
            if qc is not None and node.header.round == parent.header.round + 1:
                found.append(TwoChain(final=parent, child=node, child_qc=qc))
        return sorted(found, key=lambda chain: chain.final.header.round)

    def contradicts_root(self, node: BlockNode) -> bool:
        root, header = self.root, node.header
        if node.block_id not in self.certificates or node.block_id in self.nodes or header.round <= self.root_round:
            return False
        is_sibling = header.height == root.header.height + 1 and header.parent_id != root.block_id
        return is_sibling or header.height <= root.header.height

    def missing_ancestor(self, block_id: bytes) -> tuple[bytes, QuorumCertificate | None] | None:
        """Return the first missing ancestor's id and QC, None if all connect."""
        qc = self.certificates.get(block_id)
        while block_id not in self.nodes:
            orphan = self.orphans.get(block_id)
            if orphan is None:
                return block_id, qc
            block_id, qc = orphan.header.parent_id, orphan.header.qc
        return None

    def advance_root(self, head: BlockNode) -> list[BlockNode]:
        """Make a connected block the root, prune, and return newly final blocks."""
        path = self.branch(head.block_id)
        if path is None:
            raise AssertionError("the new root is not connected")
        self.root = head
        head.parent = None
        kept: dict[bytes, BlockNode] = {}
        waiting = [head]
        while waiting:
            node = waiting.pop()
            kept[node.block_id] = node
            waiting.extend(node.children)
        for block_id, node in self.nodes.items():
            if block_id not in kept:
                node.parent, node.children = None, []
        self.nodes = kept
        self._prune()
        return path

    def replace_root(self, head: Block, now_ms: int) -> list[BlockNode]:
        self.root = make_node(head, now_ms)
        self.root.execution = Execution.VALID
        self.nodes = {self.root.block_id: self.root}
        self.orphans.pop(self.root.block_id, None)
        self._prune()
        connected: list[BlockNode] = []
        for orphan in [node for node in self.orphans.values() if node.header.parent_id == self.root.block_id]:
            del self.orphans[orphan.block_id]
            connected.extend(self._connect(orphan))
        return connected

    def _prune(self) -> None:
        low, height = self.root_round, self.root.header.height
        self.orphans = {
            block_id: node
            for block_id, node in self.orphans.items()
            if node.header.round > low and node.header.height > height
        }
        self.certificates = {
            block_id: qc for block_id, qc in self.certificates.items() if qc.round > low or block_id in self.nodes
        }
        self._first_of_round = {number: first for number, first in self._first_of_round.items() if number > low}

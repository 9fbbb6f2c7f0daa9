"""What becomes of unfinalized blocks: executed, certified, final (R8, R22, R41)."""

from __future__ import annotations

from consensus.chain.block import Block
from consensus.protocol.block_tree import BlockNode, BlockTree, Execution
from consensus.protocol.commit_rule import choose_commit, have_contradiction
from consensus.protocol.effects import BlockCertified, CommitBlocks, Effect, ExecuteBlock, Halt
from consensus.protocol.events import BlockExecuted
from consensus.protocol.journal_builder import JournalBuilder
from consensus.protocol.pacemaker import Pacemaker


class BlockProcessor:
    """Has the tree's blocks executed and makes them final; halts where both contradict."""

    def __init__(self, tree: BlockTree, journal_builder: JournalBuilder, pacemaker: Pacemaker) -> None:
        self._tree, self._journal_builder, self._pacemaker = tree, journal_builder, pacemaker
        self._dirty = True
        self.halted = ""

    def _halt(self, reason: str) -> list[Effect]:
        if self.halted:
            return []
        self.halted = reason
        return [Halt(reason=reason)]

    # Blocks and certificates

    def check_fork(self, node: BlockNode) -> list[Effect]:
        if self._tree.has_ended or not self._tree.contradicts_root(node):
            return []
        return self._halt("A quorum certified a block that contradicts the finalized chain.")

    def connected(self, nodes: list[BlockNode]) -> list[Effect]:
        self._dirty = self._dirty or bool(nodes)
        effects: list[Effect] = []
        for node in nodes:
            if node.block_id in self._tree.certificates:
                effects += self._note_certified(node)
        for node in nodes:
            if node.parent is not None and node.parent.execution is Execution.VALID:
                effects += self._execute(node)
        return effects

    def certified(self, block_id: bytes) -> list[Effect]:
        self._dirty = True
        node = self._tree.find(block_id)
        if node is None:
            return []
        return self._note_certified(node) if block_id in self._tree.nodes else self.check_fork(node)

    def _note_certified(self, node: BlockNode) -> list[Effect]:
        effects: list[Effect] = [BlockCertified(block_id=node.block_id)]
        if node.execution is Execution.REFUSED:
            effects += self._halt("A certified block cannot be executed here.")
        elif node.execution is Execution.FAILED:
            effects += self._execute(node)
        return effects

    # Execution

    def _execute(self, node: BlockNode) -> list[Effect]:
        is_waiting = node.execution in (Execution.WAITING, Execution.FAILED)
        if not is_waiting or self.halted or self._tree.has_ended:
            return []
        node.execution = Execution.RUNNING
        return [ExecuteBlock(block=node.block, certified=node.block_id in self._tree.certificates)]

    def execute_children(self, node: BlockNode) -> list[Effect]:
        return [effect for child in node.children for effect in self._execute(child)]

    def execute_failed(self) -> list[Effect]:
        failed = [node for node in self._tree.nodes.values() if node.execution is Execution.FAILED]
        certified = [node for node in failed if node.block_id in self._tree.certificates]
        return [effect for node in certified for effect in self._execute(node)]

    def executed(self, node: BlockNode, event: BlockExecuted) -> list[Effect]:
        self._dirty = True
        is_certified = node.block_id in self._tree.certificates
        if event.fault:
            node.execution = Execution.FAILED
            return self._pacemaker.wait_to_execute() if is_certified else []
        if not event.valid:
            node.execution = Execution.REFUSED
            return self._halt("A certified block cannot be executed here.") if is_certified else []
        node.execution, node.withheld = Execution.VALID, event.withheld
        self._pacemaker.note_executed()
        return []

    # Finality

    def commit(self) -> list[Effect]:
        if not self._dirty or self._tree.has_ended:
            return []
        self._dirty = False
        chains = self._tree.two_chains()
        if not chains:
            return []
        if have_contradiction(self._tree, chains):
            return self._halt("Two contradicting blocks are final: more producers are faulty than the chain tolerates.")
        commit = choose_commit(self._tree, chains)
        path = self._tree.advance_root(commit.head)
        self._journal_builder.note_finalized(path)
        committed = CommitBlocks(blocks=tuple(node.block for node in path), proof=commit.proof)
        return [committed, *self._pacemaker.heartbeat()]

    def finalized_elsewhere(self, head: Block, now_ms: int) -> list[Effect]:
        if head.header.height <= self._tree.root.header.height:
            return []
        self._dirty = True
        node = self._tree.get(head.block_id)
        if node is None:
            effects = self.connected(self._tree.replace_root(head, now_ms))
        else:
            node.execution = Execution.VALID
            self._journal_builder.note_finalized(self._tree.advance_root(node))
            effects = self.execute_children(node)
        return [*effects, *self._pacemaker.heartbeat()]

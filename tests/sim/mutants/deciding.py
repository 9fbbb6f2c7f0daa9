"""Mutants of what makes a block certified and final (R1, R5, R8)."""

from __future__ import annotations

import pytest

from consensus.chain.block import TimeoutCertificate
from consensus.chain.schedule import Schedule
from consensus.protocol.block_tree import BlockTree, Execution, TwoChain
from tests.sim.mutants.mutant import Mutant
from tests.sim.mutants.schedules import HALVES
from tests.sim.mutants.scripts import A_BLOCK_LEFT_BEHIND, ALTERNATING_ROUNDS


def accept_2f(patch: pytest.MonkeyPatch) -> None:
    """A certificate needs 2f of 3f+1 votes only."""

    def quorum(self: Schedule) -> int:
        count = len(self.producers)
        return count - (count - 1) // 3 - 1

    patch.setattr(Schedule, "quorum", property(quorum))


def ignore_the_highest_qc(patch: pytest.MonkeyPatch) -> None:
    """A TC leads on from whatever certificate."""
    patch.setattr(TimeoutCertificate, "highest_qc_round", property(lambda self: 0))


def commit_over_gaps(patch: pytest.MonkeyPatch) -> None:
    """Any certified child makes its parent final, of the next round or not."""

    def two_chains(self: BlockTree) -> list[TwoChain]:
        found = []
        for node in self.nodes.values():
            parent, qc = node.parent, self.certificates.get(node.block_id)
            if parent is None or parent is self.root or parent.execution is not Execution.VALID or qc is None:
                continue
            found.append(TwoChain(final=parent, child=node, child_qc=qc))
        return sorted(found, key=lambda chain: chain.final.header.round)

    patch.setattr(BlockTree, "two_chains", two_chains)


DECIDING = (
    Mutant("accept a QC of 2f", "R1", accept_2f, HALVES, frozenset({"agreement"})),
    Mutant(
        "ignore the TC's highest QC", "R5, R7", ignore_the_highest_qc, A_BLOCK_LEFT_BEHIND, frozenset({"agreement"})
    ),
    Mutant("commit on non-consecutive rounds", "R8", commit_over_gaps, ALTERNATING_ROUNDS, frozenset({"agreement"})),
)

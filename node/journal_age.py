"""Finds out that a voting journal is older than the ledger beside it. Must never let such a producer sign again.

A journal put back from a backup forgets what was said since, and its producer could say something else in the same
round. The ledger's newest certificates name who signed them: one's own name in a round above the journal's last is
proof. (A whole folder put back from a backup is not noticed by this: nothing in it is newer than its journal.)
"""

from __future__ import annotations

from consensus.block import FinalityProof, Header
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode


def require_newest_journal(proof: FinalityProof, index: int | None, last_voted_round: int) -> None:
    """Compare the proof of the stored head with the journal's last round of the producer of this index.

    `index` is None for a follower, which signs nothing. Raises JOURNAL_OUTDATED.
    """
    header, child = decode(proof.header_bytes, Header), decode(proof.child_header_bytes, Header)
    spoken = [block.round for block in (header, child) if block.producer == index]
    spoken += [qc.round for qc in (child.qc, proof.child_qc) if index in {vote.index for vote in qc.votes}]
    if max(spoken, default=0) > last_voted_round:
        raise BlockRobotError(
            "JOURNAL_OUTDATED",
            f"This producer spoke in round {max(spoken)}, and its journal ends with round {last_voted_round}.",
        )

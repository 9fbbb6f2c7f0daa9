"""Failover: which errors permit trying another node, and which to raise."""

from __future__ import annotations

from collections.abc import Sequence

from consensus.errors import BlockRobotError

_FAULTY = frozenset({"PROOF_INVALID", "CERTIFICATE_INVALID", "ENCODING_NOT_CANONICAL", "ENCODING_INVALID"})
BY_ITS_CLOCK = frozenset({"TRANSACTION_EXPIRED", "TRANSACTION_TOO_FAR_AHEAD"})
"""What a node judges by its own clock. That may be wrong, and another node may have taken the transaction before."""
NOT_TAKING_PART = frozenset({"NODE_REMOVED", "CERTIFICATE_EXPIRED", "CERTIFICATE_REVOKED"})
"""What a node says that no other node hears."""
_ELSEWHERE = _FAULTY | BY_ITS_CLOCK | NOT_TAKING_PART | {"SESSION_REFUSED", "BLOCK_PRUNED"}
"""Another node may answer well: one that does not lie, or does not follow late of who is nobody, or is an archive."""

SURE_REFUSALS = frozenset({"CALL_REFUSED", "TRANSACTION_EXPIRED", "CONTRACT_DISABLED", "CONTRACT_CALL_OUTDATED"})
"""After these a transaction is not on the chain, and will not be."""


def may_ask_another(error: BlockRobotError) -> bool:
    return error.entry.retryable or error.code in _ELSEWHERE


def failure_of(failures: Sequence[BlockRobotError]) -> BlockRobotError:
    """Return the error after all nodes refused. Clock errors count only from more than half of the nodes; else nodes
    are unreachable.
    """
    by_clock = [error for error in failures if error.code in BY_ITS_CLOCK]
    others = [error for error in failures if error.code not in BY_ITS_CLOCK | {"NODE_UNREACHABLE"}]
    if others:
        return others[0]
    if 2 * len(by_clock) > len(failures):
        return by_clock[0]
    return next((error for error in failures if error not in by_clock), BlockRobotError("NODE_UNREACHABLE"))

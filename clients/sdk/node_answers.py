"""Reads nodes' JSON answers, and tells after which errors another node may be asked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import TypeVar

from consensus.api_documents import Document, Finality, Problem
from consensus.bounded_text import TextInvalidError, read_json_as
from consensus.chain.block import FinalityProof, QuorumCertificate
from consensus.errors import CATALOGUE, BlockRobotError
from consensus.primitives.encoding import decode
from consensus.visible_text import printable

D = TypeVar("D", bound=Document)
FAULTY = frozenset({"PROOF_INVALID", "CERTIFICATE_INVALID", "ENCODING_NOT_CANONICAL", "ENCODING_INVALID"})
"""What only a node says that is damaged, or lies."""
BY_ITS_CLOCK = frozenset({"TRANSACTION_EXPIRED", "TRANSACTION_TOO_FAR_AHEAD"})
"""What a node judges by its own clock. That may be wrong, and another node may have taken the transaction before."""
NOT_TAKING_PART = frozenset({"NODE_REMOVED", "CERTIFICATE_EXPIRED", "CERTIFICATE_REVOKED"})
"""What a node says that no other node hears."""
_ELSEWHERE = FAULTY | BY_ITS_CLOCK | NOT_TAKING_PART | {"SESSION_REFUSED", "BLOCK_PRUNED"}
"""Another node may answer well: one that does not lie, or does not follow late of who is nobody, or is an archive."""

SURE_REFUSALS = frozenset({"CALL_REFUSED", "TRANSACTION_EXPIRED", "CONTRACT_DISABLED", "CONTRACT_CALL_OUTDATED"})
"""After these a transaction is not on the chain, and will not be."""


def read_answer(content: bytes, kind: type[D]) -> D:
    """Raises INTERNAL if malformed."""
    try:
        return read_json_as(content, kind)
    except TextInvalidError:
        raise BlockRobotError("INTERNAL", f"The node's answer is no {kind.__name__}.") from None


def read_hex(text: str) -> bytes:
    """Raises INTERNAL."""
    try:
        return bytes.fromhex(text)
    except ValueError:
        raise BlockRobotError("INTERNAL", "The node's answer holds text where bytes are due.") from None


def error_of(problem: Problem) -> BlockRobotError:
    """Without terminal control characters; unknown codes, and none, become INTERNAL."""
    detail = printable(problem.detail or problem.title)
    if problem.code in CATALOGUE:
        return BlockRobotError(problem.code, detail)
    return BlockRobotError("INTERNAL", ": ".join(filter(None, (printable(problem.code), detail))))


def read_problem(content: bytes, status: int) -> BlockRobotError:
    try:
        problem = read_json_as(content, Problem)
    except TextInvalidError:
        problem = Problem()
    if not (problem.detail or problem.title):
        return BlockRobotError("INTERNAL", f"The node answered with status {status} and no problem document.")
    return error_of(problem)


def read_finality(document: Finality) -> FinalityProof:
    """Raises INTERNAL or ENCODING_*."""
    return FinalityProof(
        header_bytes=read_hex(document.header),
        child_header_bytes=read_hex(document.child_header),
        child_qc=decode(read_hex(document.child_qc), QuorumCertificate),
        through=tuple(read_hex(header) for header in document.through),
    )


def may_ask_another(error: BlockRobotError) -> bool:
    return error.entry.retryable or error.code in _ELSEWHERE


def failure_of(failures: Sequence[BlockRobotError]) -> BlockRobotError:
    """What to raise after all nodes refused: what most say. Clock errors count only from more than half of the nodes;
    else nodes are unreachable.
    """
    by_clock = [error for error in failures if error.code in BY_ITS_CLOCK]
    others = [error for error in failures if error.code not in BY_ITS_CLOCK | {"NODE_UNREACHABLE"}]
    if others:
        counts = Counter(error.code for error in others)
        return max(others, key=lambda error: (error.code != "NODE_ADDRESS_WRONG", counts[error.code]))
    if 2 * len(by_clock) > len(failures):
        return by_clock[0]
    return next((error for error in failures if error not in by_clock), BlockRobotError("NODE_UNREACHABLE"))

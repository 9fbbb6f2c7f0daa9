"""Nodes' JSON answers. Unknown fields are ignored for forward compatibility."""

from __future__ import annotations

from typing import TypeVar

import msgspec

from clients.sdk.terminal.ascii_output import printable
from consensus.bounded_text import TextInvalidError, read_json_as
from consensus.chain.block import FinalityProof, QuorumCertificate
from consensus.errors import CATALOGUE, BlockRobotError
from consensus.primitives.encoding import decode


class Answer(msgspec.Struct, frozen=True):
    """Base of every answer."""


A = TypeVar("A", bound=Answer)


class ProblemAnswer(Answer, frozen=True):
    """A refusal."""

    code: str
    detail: str = ""


class SubmitOutcomeAnswer(Answer, frozen=True):
    """Result of one submitted transaction."""

    txid: str | None
    status: str
    error: ProblemAnswer | None


class SubmitAnswer(Answer, frozen=True):
    """Result of a batch."""

    results: list[SubmitOutcomeAnswer]


class FinalityDocument(Answer, frozen=True):
    """A finality proof in hexadecimal."""

    header: str
    child_header: str
    child_qc: str
    through: list[str]


class EvidenceDocument(Answer, frozen=True):
    """Proof of a receipt."""

    headers: list[str]
    finality: FinalityDocument
    receipt: str
    count: int
    receipt_path: list[str]
    transaction_path: list[str]


class TransactionAnswer(Answer, frozen=True):
    """Where a transaction is."""

    status: str
    height: int | None
    index: int | None
    evidence: EvidenceDocument | None


class ChallengeAnswer(Answer, frozen=True):
    """A challenge."""

    challenge: str


class SessionAnswer(Answer, frozen=True):
    """An open session."""

    token: str
    kind: str
    expires_at_ms: int


class KeyProofDocument(Answer, frozen=True):
    """One proved key."""

    key: str
    value: str | None
    proof: str


class ProofsAnswer(Answer, frozen=True):
    """Proved keys under one root; announcements have the same parts."""

    finality: FinalityDocument | None
    proofs: list[KeyProofDocument]


class FinalityAnswer(Answer, frozen=True):
    """The newest finalized header."""

    height: int
    finality: FinalityDocument | None


class EpochsAnswer(Answer, frozen=True):
    """The steps into the next epochs."""

    epochs: list[str]


class HeadersAnswer(Answer, frozen=True):
    """Consecutive headers."""

    from_height: int
    headers: list[str]


class QueryAnswer(Answer, frozen=True):
    """The result of a view."""

    result: str
    height: int


def read_answer(content: bytes, kind: type[A]) -> A:
    """Parse a JSON answer. Raises INTERNAL if malformed."""
    try:
        return read_json_as(content, kind)
    except TextInvalidError:
        raise BlockRobotError("INTERNAL", f"The node's answer is no {kind.__name__}.") from None


def read_hex(text: str) -> bytes:
    """Decode hexadecimal. Raises INTERNAL."""
    try:
        return bytes.fromhex(text)
    except ValueError:
        raise BlockRobotError("INTERNAL", "The node's answer holds text where bytes are due.") from None


def error_of(problem: ProblemAnswer) -> BlockRobotError:
    """Return the exception, without terminal control characters; unknown codes become INTERNAL."""
    detail = printable(problem.detail)
    if problem.code in CATALOGUE:
        return BlockRobotError(problem.code, detail)
    return BlockRobotError("INTERNAL", f"{printable(problem.code)}: {detail}")


def read_problem(content: bytes, status: int) -> BlockRobotError:
    try:
        return error_of(read_json_as(content, ProblemAnswer))
    except TextInvalidError:
        return BlockRobotError("INTERNAL", f"The node answered with status {status} and no problem document.")


def read_finality(document: FinalityDocument) -> FinalityProof:
    """Return the proof. Raises INTERNAL or ENCODING_*."""
    return FinalityProof(
        header_bytes=read_hex(document.header),
        child_header_bytes=read_hex(document.child_header),
        child_qc=decode(read_hex(document.child_qc), QuorumCertificate),
        through=tuple(read_hex(header) for header in document.through),
    )

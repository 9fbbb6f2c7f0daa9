"""Reads nodes' JSON answers."""

from __future__ import annotations

from typing import TypeVar

from clients.sdk.terminal.ascii_output import printable
from consensus.api_documents import Document, Finality, Problem
from consensus.bounded_text import TextInvalidError, read_json_as
from consensus.chain.block import FinalityProof, QuorumCertificate
from consensus.errors import CATALOGUE, BlockRobotError
from consensus.primitives.encoding import decode

D = TypeVar("D", bound=Document)


def read_answer(content: bytes, kind: type[D]) -> D:
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


def error_of(problem: Problem) -> BlockRobotError:
    """Return the exception, without terminal control characters; unknown codes, and none, become INTERNAL."""
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
    """Return the proof. Raises INTERNAL or ENCODING_*."""
    return FinalityProof(
        header_bytes=read_hex(document.header),
        child_header_bytes=read_hex(document.child_header),
        child_qc=decode(read_hex(document.child_qc), QuorumCertificate),
        through=tuple(read_hex(header) for header in document.through),
    )

"""Mandate papers: salted hashes in officers' receipts; only commitments on chain."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Sequence
from pathlib import Path

import msgspec

from clients.sdk.new_files import write_new_file
from consensus.bounded_text import read_json_as
from consensus.errors import BlockRobotError
from consensus.rights.mandates import MANDATE_REASONS, PAPERS_MAX_COUNT, SALT_BYTES, commit_papers

FORMAT = "blockrobot-mandate-papers-1"
RECEIPT_MAX_BYTES = 256 * 1024
_HASH_CHUNK_BYTES = 1024 * 1024
_DIGEST_BYTES = 32


class Paper(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One paper: file name and SHA-256 (hexadecimal)."""

    file: str
    sha256: str


class PapersReceipt(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The committed reason, papers and salt (hexadecimal)."""

    format: str
    reason: str
    salt: str
    papers: list[Paper]

    @property
    def commitment(self) -> bytes:
        return commit_papers(bytes.fromhex(self.salt), self.reason, self.digests)

    @property
    def digests(self) -> list[bytes]:
        return [bytes.fromhex(paper.sha256) for paper in self.papers]


def hash_paper(path: Path) -> bytes:
    """Raises FILE_UNUSABLE."""
    digest = hashlib.sha256()
    try:
        with path.open("rb") as file:
            while chunk := file.read(_HASH_CHUNK_BYTES):
                digest.update(chunk)
    except OSError as error:
        raise BlockRobotError("FILE_UNUSABLE", f"{path}: {error.strerror or type(error).__name__}.") from None
    return digest.digest()


def make_receipt(papers: Sequence[Path], reason: str) -> PapersReceipt:
    """Hash papers with random salt. Raises FILE_UNUSABLE."""
    rows = [Paper(path.name, hash_paper(path).hex()) for path in papers]
    return PapersReceipt(FORMAT, reason, os.urandom(SALT_BYTES).hex(), rows)


def write_receipt(path: Path, receipt: PapersReceipt) -> None:
    """Write a file that only its user can read. Raises FILE_EXISTS, FILE_UNUSABLE."""
    content = msgspec.json.format(msgspec.json.encode(receipt), indent=2) + b"\n"
    try:
        write_new_file(path, content)
    except OSError as error:
        raise BlockRobotError("FILE_UNUSABLE", f"{path}: {error.strerror or type(error).__name__}.") from None


def keep_receipt(path: Path, receipt: PapersReceipt) -> tuple[PapersReceipt, bool]:
    """Write, or reuse an equal receipt and salt for retries; return whether written. Raises FILE_EXISTS, FILE_UNUSABLE."""
    try:
        write_receipt(path, receipt)
    except BlockRobotError as error:
        if error.code != "FILE_EXISTS":
            raise
        known = find_same(path, receipt)
        if known is None:
            raise
        return known, False
    return receipt, True


def find_same(path: Path, receipt: PapersReceipt) -> PapersReceipt | None:
    try:
        known = read_receipt(path)
    except BlockRobotError:
        return None
    same = (known.reason, sorted(known.digests)) == (receipt.reason, sorted(receipt.digests))
    return known if same else None


def read_receipt(path: Path) -> PapersReceipt:
    """Raises FILE_UNUSABLE, MANDATE_PAPERS_OTHER."""
    try:
        with path.open("rb") as file:
            content = file.read(RECEIPT_MAX_BYTES + 1)
    except OSError as error:
        raise BlockRobotError("FILE_UNUSABLE", f"{path}: {error.strerror or type(error).__name__}.") from None
    try:
        receipt = read_json_as(content, PapersReceipt)
        fits = receipt.format == FORMAT and receipt.reason in MANDATE_REASONS
        fits = fits and len(bytes.fromhex(receipt.salt)) == SALT_BYTES
        fits = fits and all(len(digest) == _DIGEST_BYTES for digest in receipt.digests)
        fits = fits and 0 < len(receipt.papers) <= PAPERS_MAX_COUNT
    except ValueError:
        fits = False
    if not fits:
        raise BlockRobotError("MANDATE_PAPERS_OTHER", f"{path} is no receipt of a mandate's papers.")
    return receipt


def check_papers(receipt: PapersReceipt, commitment: bytes, papers: Sequence[Path]) -> None:
    """Raise MANDATE_PAPERS_OTHER unless commitment and all papers match."""
    if receipt.commitment != commitment:
        raise BlockRobotError("MANDATE_PAPERS_OTHER", "The receipt is of other papers than those that were proposed.")
    seen = {hash_paper(path): path for path in papers}
    for digest, path in seen.items():
        if digest not in receipt.digests:
            raise BlockRobotError("MANDATE_PAPERS_OTHER", f"{path} is not one of the papers that were proposed.")
    missing = [paper.file for paper in receipt.papers if bytes.fromhex(paper.sha256) not in seen]
    if missing:
        raise BlockRobotError("MANDATE_PAPERS_OTHER", f"Of the papers that were proposed you named not {missing[0]!r}.")

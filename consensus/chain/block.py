"""Blocks, headers, certificates, receipts and their hashes; Jolteon's two-chain rule (arXiv 2106.10362)."""

from __future__ import annotations

from consensus.chain.epoch_settings import Epoch
from consensus.primitives.encoding import Wire, decode, encode
from consensus.primitives.hashing import sha256, tagged_hash, tagged_hasher
from consensus.primitives.merkle import merkle_root

HEADER_VERSION = 3
GENESIS_ROUND = 0
NO_BLOCK = bytes(32)
_hash_receipt = tagged_hasher("blockrobot/receipt-leaf")


class IndexedSignature(Wire, frozen=True):
    """A 64-byte compact signature by the producer at schedule position `index`."""

    index: int
    signature: bytes


class QuorumCertificate(Wire, frozen=True):
    """Exactly q votes for a block, sorted by producer index; none for genesis (round 0)."""

    epoch: int
    round: int
    block_id: bytes
    votes: tuple[IndexedSignature, ...]


class TimeoutSignature(Wire, frozen=True):
    """One timeout signature in a TC, with the signer's highest QC round."""

    index: int
    qc_round: int
    signature: bytes


class TimeoutCertificate(Wire, frozen=True):
    """Exactly q timeouts for one round, sorted by producer index."""

    epoch: int
    round: int
    timeouts: tuple[TimeoutSignature, ...]

    @property
    def highest_qc_round(self) -> int:
        return max(timeout.qc_round for timeout in self.timeouts)


class Header(Wire, frozen=True):
    """A block header; its id is the SHA-256 of its canonical bytes, its roots those after the block.

    `next_schedule_hash` marks a boundary, `is_closing` an empty block after it; `gives_up_change`: the due contract
    version failed (R42).
    """

    version: int
    chain_id: bytes
    epoch: int
    height: int
    round: int
    parent_id: bytes
    qc: QuorumCertificate
    tc: TimeoutCertificate | None
    producer: int
    timestamp_ms: int
    transactions_root: bytes
    receipts_root: bytes
    state_root: bytes
    next_schedule_hash: bytes | None
    gas_used: int
    is_closing: bool = False
    gives_up_change: bool = False

    @property
    def is_boundary(self) -> bool:
        """Return whether another epoch follows this block (R21)."""
        return self.next_schedule_hash is not None

    @property
    def ends_epoch(self) -> bool:
        """Return whether only closing blocks may follow in this epoch (R21)."""
        return self.is_boundary or self.is_closing


class Block(Wire, frozen=True):
    """A proposal: header bytes, producer's 64-byte signature and transactions' wire bytes."""

    header_bytes: bytes
    signature: bytes
    transactions: tuple[bytes, ...]

    @property
    def header(self) -> Header:
        """Decode the header. Raises ENCODING_*."""
        return decode(self.header_bytes, Header)

    @property
    def block_id(self) -> bytes:
        return sha256(self.header_bytes)


class ContractEvent(Wire, frozen=True):
    """A contract event; `data` is an encoded value, by convention a dict."""

    contract: str
    name: str
    data: bytes


class Receipt(Wire, frozen=True):
    """A transaction's outcome; a failed call changes nothing else."""

    txid: bytes
    ok: bool
    code: str
    message: str
    line: int | None
    gas_used: int
    events: tuple[ContractEvent, ...]


class Receipts(Wire, frozen=True):
    """A block's receipts in transaction order."""

    receipts: tuple[Receipt, ...]


class FinalityProof(Wire, frozen=True):
    """A header, its next-round child and the child's certificate (two-chain rule).

    `through`: headers before the certified pair, oldest first; only for boundaries whose child came later.
    """

    header_bytes: bytes
    child_header_bytes: bytes
    child_qc: QuorumCertificate
    through: tuple[bytes, ...] = ()


class EpochProof(Wire, frozen=True):
    """Proof that `epoch` follows the boundary block finalised by `finality`."""

    finality: FinalityProof
    epoch: Epoch


def compute_header_id(header: Header) -> bytes:
    return sha256(encode(header))


def compute_transactions_root(txids: list[bytes]) -> bytes:
    return merkle_root([tagged_hash("blockrobot/tx-leaf", txid) for txid in txids])


def compute_receipts_root(receipts: tuple[Receipt, ...]) -> bytes:
    return merkle_root([_hash_receipt(encode(receipt)) for receipt in receipts])


def certificate_of(proof: FinalityProof) -> QuorumCertificate:
    """Return the header's certificate from its child. Raises ENCODING_*."""
    child = proof.through[0] if proof.through else proof.child_header_bytes
    return decode(child, Header).qc


def genesis_certificate(genesis_id: bytes, epoch: int = 0) -> QuorumCertificate:
    """Return the round 0 certificate, without votes, of genesis or a boundary."""
    return QuorumCertificate(epoch=epoch, round=GENESIS_ROUND, block_id=genesis_id, votes=())

"""Blocks, headers, certificates and receipts, and how they are hashed. Must never depend on who looks at them.

A header carries the certificate of its parent, so a chain of headers is a chain of proofs: whoever knows the schedule
of an epoch can check any header of it, and a header with a certified child of the next round is final (Jolteon's
two-chain rule, arXiv 2106.10362).
"""

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
    """A 64-byte compact signature by the producer at `index` of the epoch's schedule."""

    index: int
    signature: bytes


class QuorumCertificate(Wire, frozen=True):
    """Exactly q votes for one block, sorted by producer index. The certificate of genesis (round 0) has none."""

    epoch: int
    round: int
    block_id: bytes
    votes: tuple[IndexedSignature, ...]


class TimeoutSignature(Wire, frozen=True):
    """One signed timeout inside a TC: who, the round of the highest QC that he named, and his signature."""

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
        """The highest QC round that any of its signers named."""
        return max(timeout.qc_round for timeout in self.timeouts)


class Header(Wire, frozen=True):
    """A block's header. Its id is the SHA-256 of its canonical bytes. Roots are those after this block.

    `next_schedule_hash` makes it a boundary: it names the next epoch (`compute_epoch_hash`). `is_closing` marks an
    empty block after a boundary, still of the old epoch, which only helps the boundary to become final.
    `gives_up_change` marks a block in which the contract's version that was due is not put into force, but failed (R42).
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
        """True if another epoch follows this block (R21)."""
        return self.next_schedule_hash is not None

    @property
    def ends_epoch(self) -> bool:
        """True if nothing but closing blocks may follow in this block's epoch (R21)."""
        return self.is_boundary or self.is_closing


class Block(Wire, frozen=True):
    """A proposal's content: the header's bytes, its producer's 64-byte signature, the transactions' wire bytes."""

    header_bytes: bytes
    signature: bytes
    transactions: tuple[bytes, ...]

    @property
    def header(self) -> Header:
        """The decoded header. Raises ENCODING_* if the bytes are none."""
        return decode(self.header_bytes, Header)

    @property
    def block_id(self) -> bytes:
        """The 32-byte id: SHA-256 of the header's canonical bytes."""
        return sha256(self.header_bytes)


class ContractEvent(Wire, frozen=True):
    """What a contract emitted: `data` is an encoded value, a dict by convention."""

    contract: str
    name: str
    data: bytes


class Receipt(Wire, frozen=True):
    """What became of one transaction. A failed call changes nothing but this."""

    txid: bytes
    ok: bool
    code: str
    message: str
    line: int | None
    gas_used: int
    events: tuple[ContractEvent, ...]


class Receipts(Wire, frozen=True):
    """All receipts of a block, in the order of its transactions."""

    receipts: tuple[Receipt, ...]


class FinalityProof(Wire, frozen=True):
    """A header, its child of the next round, and the certificate of the child: by the two-chain rule it is final.

    `through` holds the headers between `header` and the certified pair, oldest first: the pair is the last of
    (header, *through) and the child. It is empty but for boundaries whose own child was of a later round.
    """

    header_bytes: bytes
    child_header_bytes: bytes
    child_qc: QuorumCertificate
    through: tuple[bytes, ...] = ()


class EpochProof(Wire, frozen=True):
    """Proves that `epoch` follows the boundary block that `finality` shows to be final."""

    finality: FinalityProof
    epoch: Epoch


def compute_header_id(header: Header) -> bytes:
    """Return the 32-byte id of a header."""
    return sha256(encode(header))


def compute_transactions_root(txids: list[bytes]) -> bytes:
    """Return the Merkle root over txids, in block order."""
    return merkle_root([tagged_hash("blockrobot/tx-leaf", txid) for txid in txids])


def compute_receipts_root(receipts: tuple[Receipt, ...]) -> bytes:
    """Return the Merkle root over the receipts' canonical bytes, in block order."""
    return merkle_root([_hash_receipt(encode(receipt)) for receipt in receipts])


def certificate_of(proof: FinalityProof) -> QuorumCertificate:
    """Return the certificate of the proof's header: its child carries it. Raises ENCODING_* if there is no child."""
    child = proof.through[0] if proof.through else proof.child_header_bytes
    return decode(child, Header).qc


def genesis_certificate(genesis_id: bytes, epoch: int = 0) -> QuorumCertificate:
    """Return the certificate that genesis (or an epoch's boundary) stands for: round 0, no votes."""
    return QuorumCertificate(epoch=epoch, round=GENESIS_ROUND, block_id=genesis_id, votes=())

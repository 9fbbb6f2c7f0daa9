"""The smallest chain that the core can be driven on: keys, transactions that are names, states that are hashes.

A transaction may also name the epoch that is to follow.
"""

from __future__ import annotations

import msgspec

from consensus.chain.block import (
    HEADER_VERSION,
    Block,
    Header,
    QuorumCertificate,
    compute_receipts_root,
    compute_transactions_root,
)
from consensus.chain.epoch_settings import Epoch, compute_epoch_hash
from consensus.chain.messages import sign_block
from consensus.chain.transaction import TransactionWire, compute_txid
from consensus.primitives.encoding import decode, encode
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.protocol.effects import BuildBlock

CHAIN_ID = sha256(b"a chain of the simulator")
EPOCH_START_MS = 1_800_000_000_000
NO_RECEIPTS_ROOT = compute_receipts_root(())
_CHANGE = b"change"
_MARK_SIZE = len(_CHANGE) + 8


def make_keys(count: int) -> list[PrivateKey]:
    """Return the producers' keys, the same in every run."""
    return [PrivateKey(sha256(b"producer %d" % number)) for number in range(count)]


def make_transaction(number: int) -> bytes:
    """Return wire bytes that have a txid; nobody looks at their signature here."""
    return encode(TransactionWire(body=b"transaction %d" % number, signature=b""))


def make_change(number: int, epoch: Epoch) -> bytes:
    """Return a transaction that makes its block a boundary: the next epoch is this one, whatever its number."""
    return encode(TransactionWire(body=_CHANGE + number.to_bytes(8, "big") + encode(epoch), signature=b""))


def find_next_epoch(current: Epoch, transactions: tuple[bytes, ...]) -> Epoch | None:
    """Return the epoch that a block with these transactions decides; the last one that names any counts."""
    bodies = [decode(wire, TransactionWire).body for wire in transactions]
    named = [decode(body[_MARK_SIZE:], Epoch) for body in bodies if body.startswith(_CHANGE)]
    return msgspec.structs.replace(named[-1], number=current.number + 1) if named else None


def txid_of(wire: bytes) -> bytes:
    return compute_txid(decode(wire, TransactionWire).body)


def make_genesis_block() -> Block:
    """Return a block of height 0 without contracts."""
    header = Header(
        version=HEADER_VERSION,
        chain_id=CHAIN_ID,
        epoch=0,
        height=0,
        round=0,
        parent_id=bytes(32),
        qc=QuorumCertificate(epoch=0, round=0, block_id=bytes(32), votes=()),
        tc=None,
        producer=0,
        timestamp_ms=EPOCH_START_MS - 1,
        transactions_root=compute_transactions_root([]),
        receipts_root=NO_RECEIPTS_ROOT,
        state_root=sha256(b"the first state"),
        next_schedule_hash=None,
        gas_used=0,
    )
    return Block(header_bytes=encode(header), signature=b"", transactions=())


def execute(parent: Header, transactions: tuple[bytes, ...]) -> bytes:
    """Return the state root after these transactions."""
    return sha256(parent.state_root + b"".join(transactions))


def hash_next_epoch(current: Epoch, transactions: tuple[bytes, ...]) -> bytes | None:
    """Return what the header of a block with these transactions says about the next epoch."""
    following = find_next_epoch(current, transactions)
    return None if following is None else compute_epoch_hash(following)


def build_block(
    order: BuildBlock,
    parent: Header,
    transactions: tuple[bytes, ...],
    key: PrivateKey,
    now: int,
    next_schedule_hash: bytes | None = None,
) -> Block:
    """Return the signed block that a leader's executor would build."""
    header = Header(
        version=HEADER_VERSION,
        chain_id=CHAIN_ID,
        epoch=order.epoch,
        height=order.height,
        round=order.round,
        parent_id=order.parent_id,
        qc=order.qc,
        tc=order.tc,
        producer=order.producer,
        timestamp_ms=max(order.parent_timestamp_ms + 1, now),
        transactions_root=compute_transactions_root([txid_of(wire) for wire in transactions]),
        receipts_root=NO_RECEIPTS_ROOT,
        state_root=parent.state_root if order.closing else execute(parent, transactions),
        next_schedule_hash=next_schedule_hash,
        gas_used=0,
        is_closing=order.closing,
    )
    data = encode(header)
    signature = sign_block(key, CHAIN_ID, order.epoch, order.round, sha256(data))
    return Block(header_bytes=data, signature=signature, transactions=transactions)

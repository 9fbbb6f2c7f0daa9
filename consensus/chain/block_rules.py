"""Stateless validity rules of blocks.

The id covers only the header, so a failing block does not incriminate its producer.
"""

from __future__ import annotations

from consensus.chain.block import (
    GENESIS_ROUND,
    HEADER_VERSION,
    Block,
    Header,
    compute_receipts_root,
    compute_transactions_root,
)
from consensus.chain.messages import PROPOSAL_TAG, proposal_parts
from consensus.chain.schedule import Schedule, verify_qc, verify_tc
from consensus.chain.signature_cache import SignatureCheck
from consensus.chain.transaction import TransactionWire, compute_txid
from consensus.errors import BlockRobotError
from consensus.limits import BLOCK_GAS_MAX, BLOCK_SIZE_MAX_BYTES, BLOCK_TRANSACTIONS_MAX_COUNT
from consensus.primitives.encoding import EXACT_INTEGER_END, decode
from consensus.primitives.hashing import HASH_SIZE_BYTES, sha256

_NO_TRANSACTIONS_ROOT = compute_transactions_root([])
_NO_RECEIPTS_ROOT = compute_receipts_root(())


def _require(condition: bool, detail: str) -> None:
    if not condition:
        raise BlockRobotError("BLOCK_INVALID", detail)


def is_safe_to_extend(header: Header) -> bool:
    """Return whether a header's QC or TC justifies its round (R5)."""
    if header.qc.round == header.round - 1:
        return True
    tc = header.tc
    return tc is not None and tc.round == header.round - 1 and header.qc.round >= tc.highest_qc_round


def may_give_up_change(header: Header, schedule: Schedule) -> bool:
    """Return whether more leaders than may be faulty lost their turns (R42)."""
    lost_rounds = header.round - header.qc.round - 1
    return lost_rounds >= lost_rounds_before_giving_up(schedule)


def lost_rounds_before_giving_up(schedule: Schedule) -> int:
    return schedule.blocks_per_turn * (schedule.faults_tolerated + 1)


def check_header_form(header: Header, chain_id: bytes, schedule: Schedule) -> None:
    """Check header fields that need neither signature nor parent. Raises BLOCK_INVALID."""
    _require(header.version == HEADER_VERSION, f"The block has version {header.version}.")
    _require(header.chain_id == chain_id, "The block is of another chain.")
    _require(header.epoch == schedule.epoch, "The block is of another epoch.")
    _require(
        0 < header.round < EXACT_INTEGER_END and 0 < header.height < EXACT_INTEGER_END,
        "The round or height is impossible.",
    )
    _require(header.producer == schedule.leader(header.round), "The producer does not lead this round.")
    _require(header.qc.block_id == header.parent_id, "The certificate is not the parent's.")
    _require(0 <= header.qc.round < header.round, "The parent's round is not below the block's.")
    _require(
        header.tc is None or header.qc.round != header.round - 1, "A timeout certificate stands beside a fresh QC."
    )
    _require(
        0 <= header.timestamp_ms < EXACT_INTEGER_END and 0 <= header.gas_used <= BLOCK_GAS_MAX, "A number is too large."
    )
    roots = (header.parent_id, header.transactions_root, header.receipts_root, header.state_root)
    _require(all(len(root) == HASH_SIZE_BYTES for root in roots), "A root has a wrong size.")
    _check_epoch_fields(header)


def _check_epoch_fields(header: Header) -> None:
    if header.next_schedule_hash is not None:
        _require(len(header.next_schedule_hash) == HASH_SIZE_BYTES, "The next epoch's hash has a wrong size.")
        _require(not header.is_closing, "A closing block ends its epoch a second time.")
    if header.is_closing:
        is_empty = (
            header.transactions_root == _NO_TRANSACTIONS_ROOT
            and header.receipts_root == _NO_RECEIPTS_ROOT
            and header.gas_used == 0
        )
        _require(is_empty, "A closing block is not empty.")
        _require(not header.gives_up_change, "A closing block gives up a change.")


def is_fit_for_parent(header: Header, parent: Header) -> bool:
    """Return whether a block fits its parent, possibly the boundary (R14, R21, R23)."""
    parent_round, is_closing = parent.round, parent.ends_epoch
    if parent.epoch != header.epoch:
        parent_round, is_closing = GENESIS_ROUND, False
    return (
        header.height == parent.height + 1
        and header.qc.round == parent_round
        and header.timestamp_ms > parent.timestamp_ms
        and header.is_closing == is_closing
        and (header.state_root == parent.state_root or not is_closing)
    )


def check_body(block: Block, header: Header) -> None:
    """Raises BLOCK_INVALID or ENCODING_*."""
    _require(len(block.transactions) <= BLOCK_TRANSACTIONS_MAX_COUNT, "The block has too many transactions.")
    _require(sum(map(len, block.transactions)) <= BLOCK_SIZE_MAX_BYTES, "The block is too large.")
    txids = [compute_txid(decode(wire, TransactionWire).body) for wire in block.transactions]
    _require(compute_transactions_root(txids) == header.transactions_root, "The transactions are not the header's.")


def check_block(
    block: Block, header: Header, *, chain_id: bytes, schedule: Schedule, round_zero_id: bytes, check: SignatureCheck
) -> None:
    """Check form, body, signature and certificates. Raises BLOCK_INVALID, CERTIFICATE_INVALID, ENCODING_*."""
    check_header_form(header, chain_id, schedule)
    producer_key = schedule.producers[header.producer]
    parts = proposal_parts(chain_id, header.epoch, header.round, sha256(block.header_bytes))
    _require(check(producer_key, PROPOSAL_TAG, block.signature, *parts), "The block is not signed by its producer.")
    check_body(block, header)
    verify_qc(header.qc, schedule, chain_id, round_zero_id, check)
    if header.tc is not None:
        verify_tc(header.tc, schedule, chain_id, check)
    _require(is_safe_to_extend(header), "Neither the QC nor a timeout certificate leads into the block's round.")

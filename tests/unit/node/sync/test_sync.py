"""Blocks from a peer are installed only if a quorum made the last of them final and all lead up to it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import msgspec
import pytest

from consensus.chain.block import Block, EpochProof, FinalityProof, genesis_certificate
from consensus.chain.messages import sign_block
from consensus.chain.transaction import decode_transaction
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode, encode
from consensus.primitives.hashing import sha256
from node.consensus.epoch_change import start_of_genesis
from node.snapshot.making import header_of_block
from node.storage.memory_store import MemoryStore
from node.sync.block_ranges import check_range, finality_of, proof_from_blocks, read_range
from tests.unit.node.hand_made_chain import KEYS, certify, make_chain, make_genesis, prove, stored

GENESIS = make_genesis()
CHAIN = make_chain(GENESIS, 12)


async def _ledger(height: int, chain: list[Block] = CHAIN) -> MemoryStore:
    ledger = MemoryStore()
    await ledger.commit([stored(chain[0])], b"")
    if height:
        await ledger.commit([stored(block) for block in chain[1 : height + 1]], encode(prove(GENESIS, chain, height)))
    return ledger


async def _refusal(blocks: list[Block], proof: FinalityProof, height: int = 0) -> str:
    error = await _error(blocks, proof, height)
    return "" if error is None else error.code


async def _error(blocks: list[Block], proof: FinalityProof, height: int = 0) -> BlockRobotError | None:
    try:
        check_range(
            blocks,
            proof,
            from_height=height + 1,
            start=start_of_genesis(GENESIS),
            chain_id=GENESIS.chain_id,
            read=decode_transaction,
        )
    except BlockRobotError as error:
        return error
    return None


async def test_a_run_of_blocks_is_believed_with_its_own_proof_alone() -> None:
    assert await _refusal(CHAIN[1:9], prove(GENESIS, CHAIN, 8)) == ""
    assert await _refusal(CHAIN[5:9], prove(GENESIS, CHAIN, 8), height=4) == ""
    child = CHAIN[9]
    proof = FinalityProof(CHAIN[8].header_bytes, child.header_bytes, certify(GENESIS, child, (0, 1)))
    assert await _refusal(CHAIN[1:9], proof) == "CERTIFICATE_INVALID"
    child = CHAIN[10]
    proof = FinalityProof(CHAIN[8].header_bytes, child.header_bytes, certify(GENESIS, child))
    assert await _refusal(CHAIN[1:9], proof) == "PROOF_INVALID"
    assert await _refusal(CHAIN[1:9], prove(GENESIS, CHAIN, 7)) == "CERTIFICATE_INVALID"


async def test_a_run_with_a_gap_or_a_block_that_was_changed_or_signed_by_another_is_noticed() -> None:
    assert await _refusal([*CHAIN[1:4], *CHAIN[5:9]], prove(GENESIS, CHAIN, 8)) == "BLOCK_INVALID"
    assert await _refusal(CHAIN[2:9], prove(GENESIS, CHAIN, 8)) == "BLOCK_INVALID"
    header = msgspec.structs.replace(CHAIN[3].header, gas_used=5)
    data = encode(header)
    changed = Block(data, sign_block(KEYS[header.producer], header.chain_id, 0, header.round, sha256(data)), ())
    assert await _refusal([*CHAIN[1:3], changed, *CHAIN[4:9]], prove(GENESIS, CHAIN, 8)) == "BLOCK_INVALID"
    # The id of a block does not cover its producer's signature.
    forged = msgspec.structs.replace(CHAIN[3], signature=CHAIN[2].signature)
    assert await _refusal([*CHAIN[1:3], forged, *CHAIN[4:9]], prove(GENESIS, CHAIN, 8)) == "BLOCK_INVALID"


@pytest.mark.parametrize("from_height", [1, 5, 9])
async def test_what_a_node_serves_is_what_another_believes(from_height: int) -> None:
    ledger = await _ledger(10)
    with ledger.snapshot() as snapshot:
        batch = read_range(snapshot, from_height, 64)
    assert batch.proof is not None
    blocks = [decode(data, Block) for data in batch.blocks]
    assert blocks == CHAIN[from_height:11]
    assert await _refusal(blocks, batch.proof, height=from_height - 1) == ""


async def test_a_long_chain_is_served_in_parts_each_with_its_proof() -> None:
    ledger = await _ledger(10)
    with ledger.snapshot() as snapshot:
        for from_height, asked, last in ((1, 4, 4), (5, 4, 8), (9, 1, 10)):
            batch = read_range(snapshot, from_height, asked)
            assert len(batch.blocks) == last + 1 - from_height
            assert batch.proof is not None
            assert batch.proof.header_bytes == CHAIN[last].header_bytes
        beyond = read_range(snapshot, 11, 4)
    assert (beyond.blocks, beyond.proof) == ((), None)


async def test_a_pruned_run_is_not_served_and_the_peer_hears_from_where_on_there_is_one() -> None:
    ledger = await _ledger(10)
    await ledger.prune(5, header_of_block)
    with ledger.snapshot() as snapshot:
        batch = read_range(snapshot, 3, 4)
        later = read_range(snapshot, 5, 2)
    assert (batch.blocks, batch.proof, batch.earliest_height) == ((), None, 5)
    assert (len(later.blocks), later.earliest_height) == (2, 5)


def _changed(block: Block, **changes: Any) -> Block:
    header = msgspec.structs.replace(block.header, **changes)
    data = encode(header)
    signature = sign_block(KEYS[header.producer], header.chain_id, header.epoch, header.round, sha256(data))
    return Block(data, signature, ())


@pytest.mark.parametrize("changes", [{"next_schedule_hash": bytes(32)}, {"is_closing": True}])
async def test_a_run_that_goes_on_behind_a_boundary_is_not_believed(changes: dict[str, Any]) -> None:
    changed = _changed(CHAIN[3], **changes)
    error = await _error([*CHAIN[1:3], changed, *CHAIN[4:9]], prove(GENESIS, CHAIN, 8))
    assert error is not None
    assert (error.code, "behind a boundary" in error.detail) == ("BLOCK_INVALID", True)


async def test_a_run_of_another_epoch_proves_nothing() -> None:
    proof = prove(GENESIS, CHAIN, 8)
    later = encode(msgspec.structs.replace(CHAIN[8].header, epoch=1))
    foreign = msgspec.structs.replace(proof, header_bytes=later)
    assert await _refusal(CHAIN[1:9], foreign) == "PROOF_OTHER_EPOCH"
    below, boundary = CHAIN[1], _changed(CHAIN[2], next_schedule_hash=bytes(32))
    first = _changed(
        CHAIN[3], epoch=1, round=1, parent_id=boundary.block_id, qc=genesis_certificate(boundary.block_id, 1)
    )
    assert proof_from_blocks(below, boundary, first) is None


async def test_a_run_ends_at_the_boundary_with_the_proof_that_began_the_next_epoch() -> None:
    boundary = _changed(CHAIN[3], next_schedule_hash=bytes(32))
    own = FinalityProof(boundary.header_bytes, b"child", certify(GENESIS, boundary), (b"between",))
    epoch = msgspec.structs.replace(GENESIS.epoch, number=1)
    ledger = MemoryStore()
    blocks = [stored(block) for block in [*CHAIN[:3], boundary, *CHAIN[4:8]]]
    blocks[3] = replace(blocks[3], epoch_proof_bytes=encode(EpochProof(own, epoch)))
    await ledger.commit(blocks, encode(prove(GENESIS, CHAIN, 7)))
    with ledger.snapshot() as snapshot:
        batch = read_range(snapshot, 1, 64)
        assert finality_of(snapshot, 3) == own
    assert len(batch.blocks) == 3
    assert batch.proof == own

"""A chain of empty blocks signed by four producers, made by hand: for tests that need blocks which others would accept."""

from __future__ import annotations

from consensus.chain.block import (
    HEADER_VERSION,
    Block,
    FinalityProof,
    Header,
    IndexedSignature,
    QuorumCertificate,
    Receipts,
    genesis_certificate,
)
from consensus.chain.genesis import ChainSettings, Genesis, NodeEntry
from consensus.chain.messages import sign_block, sign_vote
from consensus.primitives.encoding import encode
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.primitives.merkle import merkle_root
from contracts.state.view import MemoryState
from node.storage.ledger_store import FinalizedBlock

KEYS = [PrivateKey(sha256(b"producer %d" % number)) for number in range(4)]
START_MS = 1_700_000_000_000


def make_genesis() -> Genesis:
    nodes = tuple(
        NodeEntry(f"node-{number}", "hospital", "127.0.0.1", 1 + number, "", key.public_key, b"", b"")
        for number, key in enumerate(KEYS)
    )
    return Genesis(1, "test", START_MS, ChainSettings(), (), nodes, (), (), MemoryState().state_root)


def certify(genesis: Genesis, block: Block, signers: tuple[int, ...] = (0, 1, 2)) -> QuorumCertificate:
    """A certificate by these producers."""
    header = block.header
    votes = [sign_vote(KEYS[index], genesis.chain_id, 0, header.round, block.block_id, index) for index in signers]
    return QuorumCertificate(
        0, header.round, block.block_id, tuple(IndexedSignature(vote.index, vote.signature) for vote in votes)
    )


def make_chain(genesis: Genesis, length: int) -> list[Block]:
    """Genesis and `length` blocks, one each round."""
    blocks, qc = [genesis.block()], genesis_certificate(genesis.block_id)
    for height in range(1, length + 1):
        producer = genesis.schedule.leader(height)
        empty = merkle_root([])
        header = Header(
            HEADER_VERSION,
            genesis.chain_id,
            0,
            height,
            height,
            blocks[-1].block_id,
            qc,
            None,
            producer,
            START_MS + height,
            empty,
            empty,
            genesis.state_root,
            None,
            0,
        )
        data = encode(header)
        blocks.append(Block(data, sign_block(KEYS[producer], genesis.chain_id, 0, height, sha256(data)), ()))
        qc = certify(genesis, blocks[-1])
    return blocks


def prove(genesis: Genesis, blocks: list[Block], height: int) -> FinalityProof:
    """The two-chain proof of one block of the chain."""
    child = blocks[height + 1]
    return FinalityProof(blocks[height].header_bytes, child.header_bytes, certify(genesis, child))


def stored(block: Block) -> FinalizedBlock:
    header = block.header
    return FinalizedBlock(
        header.height, block.block_id, encode(block), encode(Receipts(())), header.timestamp_ms, header.state_root
    )

"""What a wallet, robot or auditor needs to believe a node: the genesis file and this module. Must never trust a node.

A header is final if it and a child of the next round are both certified (R8); a value is the ledger's if a proof leads
from it to the state root of a final header (R19). The newest header seen is pinned, so that no node can take its user
back in time (R20).
"""

from __future__ import annotations

from typing import Any

from consensus.block import FinalityProof, Header
from consensus.errors import BlockRobotError
from consensus.genesis import Genesis
from consensus.primitives.encoding import decode, decode_value
from consensus.primitives.hashing import sha256
from consensus.primitives.trie import Proof, verify_proof
from consensus.schedule import Schedule, verify_qc


def _require(condition: bool, detail: str) -> None:
    if not condition:
        raise BlockRobotError("PROOF_INVALID", detail)


def verify_finality(proof: FinalityProof, schedule: Schedule, chain_id: bytes, genesis_id: bytes) -> Header:
    """Return the header that the proof shows to be final (R8, R19).

    Raises PROOF_INVALID if the headers are not of one chain in consecutive rounds, CERTIFICATE_INVALID if a certificate
    is not a quorum's, ENCODING_* if the bytes are no headers.
    """
    header, child = decode(proof.header_bytes, Header), decode(proof.child_header_bytes, Header)
    header_id, child_id = sha256(proof.header_bytes), sha256(proof.child_header_bytes)
    _require(header.chain_id == chain_id and child.chain_id == chain_id, "A header is of another chain.")
    _require(header.epoch == schedule.epoch and child.epoch == schedule.epoch, "A header is of another epoch.")
    _require(child.parent_id == header_id and child.height == header.height + 1, "The second header is no child.")
    _require(child.round == header.round + 1, "The child is not of the next round: it makes nothing final.")
    _require(child.qc.block_id == header_id and child.qc.round == header.round, "The child certifies another block.")
    _require(
        proof.child_qc.block_id == child_id and proof.child_qc.round == child.round,
        "The certificate is not the child's.",
    )
    verify_qc(child.qc, schedule, chain_id, genesis_id)
    verify_qc(proof.child_qc, schedule, chain_id, genesis_id)
    return header


class LightClient:
    """Follows one chain from its genesis file; pins the newest header that it verified."""

    def __init__(self, genesis: Genesis, pinned_header_bytes: bytes | None = None) -> None:
        """Begin at genesis, or at a header that this client itself verified and kept. Raises ENCODING_*."""
        self._schedule = genesis.schedule
        self._chain_id = genesis.chain_id
        self._genesis_id = genesis.block_id
        block = genesis.block()
        self._header_bytes = block.header_bytes if pinned_header_bytes is None else pinned_header_bytes
        self._header = decode(self._header_bytes, Header)
        _require(self._header.chain_id == self._chain_id, "The pinned header is of another chain.")

    @property
    def header(self) -> Header:
        """The newest header that was verified."""
        return self._header

    @property
    def header_id(self) -> bytes:
        """The 32-byte id of the pinned header."""
        return sha256(self._header_bytes)

    @property
    def pinned_header_bytes(self) -> bytes:
        """The pinned header's bytes, for a client that keeps them between runs."""
        return self._header_bytes

    def accept(self, proof: FinalityProof) -> Header:
        """Verify a proof and pin its header, if it is newer (R20); return the header.

        Raises PROOF_STALE for an older header, PROOF_INVALID for one that contradicts the pinned one, and what
        `verify_finality` raises.
        """
        header = verify_finality(proof, self._schedule, self._chain_id, self._genesis_id)
        pinned = self._header
        if header.height < pinned.height and header.round < pinned.round:
            raise BlockRobotError(
                "PROOF_STALE", f"The proof is about height {header.height}; height {pinned.height} was final before."
            )
        if proof.header_bytes == self._header_bytes:
            return header
        _require(
            header.height > pinned.height and header.round > pinned.round,
            "Two contradicting headers are proven final: more producers are faulty than the chain tolerates.",
        )
        self._header, self._header_bytes = header, proof.header_bytes
        return header

    def verify_state(self, proof: FinalityProof, key: bytes, value: bytes | None, state_proof: Proof) -> Any:
        """Return the decoded value that the flat key holds in the state after the proof's header; None if absent.

        `value` is what the node claims: encoded bytes, or None for an absent key. Raises what `accept` raises,
        PROOF_INVALID if the state proof does not lead to the header's state root, and ENCODING_* for no value.
        """
        header = self.accept(proof)
        verify_proof(header.state_root, key, value, state_proof)
        return None if value is None else decode_value(value)

"""Ledger state from proofs alone: genesis, epochs, headers, state, receipts."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from clients.bundle.documents import ReceiptProof, StateProofs, read_bytes
from consensus.chain.block import EpochProof, FinalityProof, Header, Receipt
from consensus.chain.genesis import Genesis
from consensus.chain.light_client import LightClient, verify_finality
from consensus.chain.schedule import Schedule
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode, decode_value, encode
from consensus.primitives.hashing import sha256, tagged_hash
from consensus.primitives.merkle import verify_merkle_proof
from consensus.primitives.trie import Proof, verify_proof

EPOCHS_MAX_COUNT = 100_000
HEADERS_MAX_COUNT = 256


@dataclass(frozen=True, slots=True)
class ProvedValue:
    """A decoded state value (None: proved absent) and its final block."""

    value: Any
    height: int
    time_ms: int


@dataclass(frozen=True, slots=True)
class ProvedReceipt:
    """A transaction's receipt and its position."""

    receipt: Receipt
    height: int
    index: int
    time_ms: int


class ProvedChain:
    """One chain from genesis; refuses contradicting final headers."""

    def __init__(self, genesis: Genesis, epochs: Sequence[str]) -> None:
        """Raises BUNDLE_INVALID, CERTIFICATE_INVALID, PROOF_INVALID, PROOF_OTHER_EPOCH."""
        if len(epochs) > EPOCHS_MAX_COUNT:
            raise BlockRobotError("BUNDLE_INVALID", "The bundle names more epochs than any chain has.")
        client = LightClient(genesis)
        self._chain_id = genesis.chain_id
        self._steps: list[tuple[Schedule, bytes]] = [(genesis.schedule, genesis.block_id)]
        self._ids: dict[int, bytes] = {0: genesis.block_id}
        self._final: dict[bytes, Header] = {}
        self.times_ms: dict[int, int] = {}
        for number, text in enumerate(epochs, 1):
            proof = decode(read_bytes("proofs/chain.json", text), EpochProof)
            if proof.epoch.number != number:
                raise BlockRobotError("PROOF_OTHER_EPOCH", f"Step {number} leads to epoch {proof.epoch.number}.")
            client.advance(proof)
            boundary = proof.finality.header_bytes
            self._note(decode(boundary, Header), boundary)
            self._steps.append((Schedule.of(proof.epoch), sha256(boundary)))

    @property
    def epoch_count(self) -> int:
        return len(self._steps)

    def _note(self, header: Header, header_bytes: bytes) -> None:
        known = self._ids.setdefault(header.height, sha256(header_bytes))
        if known != sha256(header_bytes):
            raise BlockRobotError("PROOF_INVALID", f"Two different blocks of height {header.height} are called final.")

    def final(self, raw: bytes) -> Header:
        """`raw`: an encoded `FinalityProof`."""
        known = self._final.get(raw)
        if known is not None:
            return known
        proof = decode(raw, FinalityProof)
        epoch = decode(proof.header_bytes, Header).epoch
        if not 0 <= epoch < len(self._steps):
            raise BlockRobotError("PROOF_OTHER_EPOCH", f"The bundle does not lead to epoch {epoch}.")
        schedule, first_id = self._steps[epoch]
        header = verify_finality(proof, schedule, self._chain_id, first_id)
        self._note(header, proof.header_bytes)
        self._final[raw] = header
        self.times_ms[header.height] = header.timestamp_ms
        return header

    def state(self, name: str, proofs: StateProofs) -> dict[bytes, ProvedValue]:
        """By flat key. Raises BUNDLE_INVALID for duplicates."""
        found: dict[bytes, ProvedValue] = {}
        for snapshot in proofs.snapshots:
            header = self.final(read_bytes(name, snapshot.finality))
            for part in snapshot.keys:
                key = read_bytes(name, part.key)
                if key in found:
                    raise BlockRobotError("BUNDLE_INVALID", f"{name} proves one key twice.")
                value = None if part.value is None else read_bytes(name, part.value)
                verify_proof(header.state_root, key, value, decode(read_bytes(name, part.proof), Proof))
                decoded = None if value is None else decode_value(value)
                found[key] = ProvedValue(decoded, header.height, header.timestamp_ms)
            if not snapshot.keys:
                raise BlockRobotError("BUNDLE_INVALID", f"{name} has a block that proves nothing.")
        return found

    def receipt(self, name: str, proof: ReceiptProof) -> ProvedReceipt:
        """Raises PROOF_INVALID."""
        chain = [read_bytes(name, header) for header in proof.headers]
        raw = read_bytes(name, proof.finality)
        if not 1 <= len(chain) <= HEADERS_MAX_COUNT or decode(raw, FinalityProof).header_bytes != chain[-1]:
            raise BlockRobotError("PROOF_INVALID", "The headers of a receipt do not lead to the block proved final.")
        self.final(raw)
        for lower, upper in itertools.pairwise(chain):
            if decode(upper, Header).parent_id != sha256(lower):
                raise BlockRobotError("PROOF_INVALID", "The headers of a receipt do not follow each other.")
        header = decode(chain[0], Header)
        receipt = decode(read_bytes(name, proof.receipt), Receipt)
        self._require_leaf(name, header.receipts_root, "receipt", encode(receipt), proof, proof.receipt_path)
        self._require_leaf(name, header.transactions_root, "tx", receipt.txid, proof, proof.transaction_path)
        self._note(header, chain[0])
        return ProvedReceipt(receipt, header.height, proof.index, header.timestamp_ms)

    def _require_leaf(
        self, name: str, root: bytes, kind: str, content: bytes, proof: ReceiptProof, path: list[str]
    ) -> None:
        leaf = tagged_hash(f"blockrobot/{kind}-leaf", content)
        nodes = [read_bytes(name, node) for node in path]
        if not verify_merkle_proof(root, leaf, proof.index, proof.count, nodes):
            raise BlockRobotError("PROOF_INVALID", "A receipt does not stand in the block that it is claimed for.")

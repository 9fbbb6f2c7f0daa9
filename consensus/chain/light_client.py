"""The light client: proves headers and values without trusting nodes (R8, R19, R20, R26)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

from consensus.chain.block import EpochProof, FinalityProof, Header
from consensus.chain.epoch_settings import Epoch
from consensus.chain.genesis import Genesis
from consensus.chain.schedule import Schedule, compute_epoch_hash, verify_qc
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode, decode_value
from consensus.primitives.hashing import sha256
from consensus.primitives.trie import Proof, verify_proof


def _require(condition: bool, detail: str) -> None:
    if not condition:
        raise BlockRobotError("PROOF_INVALID", detail)


def verify_finality(proof: FinalityProof, schedule: Schedule, chain_id: bytes, round_zero_id: bytes) -> Header:
    """Return the header proven final (R8, R19, R22); `round_zero_id` is genesis or the boundary.

    Raises PROOF_OTHER_EPOCH, PROOF_INVALID, CERTIFICATE_INVALID, ENCODING_*.
    """
    raw = [proof.header_bytes, *proof.through, proof.child_header_bytes]
    headers = [decode(data, Header) for data in raw]
    header, child = headers[0], headers[-1]
    _require(all(each.chain_id == chain_id for each in headers), "A header is of another chain.")
    if header.epoch != schedule.epoch:
        raise BlockRobotError(
            "PROOF_OTHER_EPOCH", f"The header is of epoch {header.epoch}, not {schedule.epoch}.", epoch=header.epoch
        )
    _require(all(each.epoch == schedule.epoch for each in headers), "The headers are of different epochs.")
    _require(not header.is_closing, "A block that closes its epoch is never final.")
    _require(header.is_boundary or not proof.through, "Only a boundary is proven through other headers.")
    certificates = [each.qc for each in headers[1:]] + [proof.child_qc]
    ids = [sha256(data) for data in raw]
    for (above, below), below_id in zip(itertools.pairwise(reversed(headers)), reversed(ids[:-1]), strict=True):
        _require(
            above.parent_id == below_id and above.height == below.height + 1, "A header is no child of the one before."
        )
        _require(
            above.is_closing == below.ends_epoch and above.round > below.round, "A header does not follow its parent."
        )
    _require(child.round == headers[-2].round + 1, "The child is not of the next round: it makes nothing final.")
    for each, block_id, qc in zip(headers, ids, certificates, strict=True):
        _require(qc.block_id == block_id and qc.round == each.round, "A certificate is another header's.")
        verify_qc(qc, schedule, chain_id, round_zero_id)
    return header


class LightClient:
    """Follows one chain through its epochs, pinning the newest verified header."""

    def __init__(
        self, genesis: Genesis, pinned_header_bytes: bytes | None = None, epochs: Sequence[EpochProof] = ()
    ) -> None:
        """Start at genesis, or from a kept header and its `epochs`.

        Without all epochs up to the header's, nothing is accepted before `advance`. Raises ENCODING_*, and as
        `advance`.
        """
        self._chain_id = genesis.chain_id
        self._epoch = genesis.epoch
        self._schedule = genesis.schedule
        self._round_zero_id = genesis.block_id
        self._epochs: list[EpochProof] = []
        block = genesis.block()
        self._header_bytes = block.header_bytes if pinned_header_bytes is None else pinned_header_bytes
        self._header = decode(self._header_bytes, Header)
        _require(self._header.chain_id == self._chain_id, "The pinned header is of another chain.")
        for proof in epochs:
            self.advance(proof)

    @property
    def header(self) -> Header:
        return self._header

    @property
    def header_id(self) -> bytes:
        return sha256(self._header_bytes)

    @property
    def pinned_header_bytes(self) -> bytes:
        return self._header_bytes

    @property
    def epoch(self) -> Epoch:
        return self._epoch

    @property
    def epochs(self) -> tuple[EpochProof, ...]:
        return tuple(self._epochs)

    def advance(self, proof: EpochProof) -> Epoch:
        """Enter the next epoch (R26); a known one is not reverified. Return the current epoch.

        Raises PROOF_OTHER_EPOCH for gaps, PROOF_INVALID, GENESIS_INVALID without producers, and as `verify_finality`.
        """
        if proof.epoch.number <= self._epoch.number:
            self._require_known(proof)
            return self._epoch
        if proof.epoch.number != self._epoch.number + 1:
            raise BlockRobotError(
                "PROOF_OTHER_EPOCH",
                f"The proof is about epoch {proof.epoch.number}; this client is in epoch {self._epoch.number}.",
                epoch=proof.epoch.number,
            )
        boundary = verify_finality(proof.finality, self._schedule, self._chain_id, self._round_zero_id)
        _require(
            boundary.next_schedule_hash == compute_epoch_hash(proof.epoch), "The boundary names another next epoch."
        )
        schedule = Schedule.of(proof.epoch)
        boundary_bytes = proof.finality.header_bytes
        is_older = self._is_older(boundary)
        _require(
            not is_older or self._header.epoch > boundary.epoch,
            "A header after the boundary was final in its epoch: more producers are faulty than the chain tolerates.",
        )
        if not is_older:
            self._pin(boundary, boundary_bytes)
        self._epoch, self._schedule, self._round_zero_id = proof.epoch, schedule, sha256(boundary_bytes)
        self._epochs.append(proof)
        return self._epoch

    def _require_known(self, proof: EpochProof) -> None:
        number = proof.epoch.number
        known = self._epochs[number - 1] if number > 0 else None
        _require(
            known is not None
            and known.epoch == proof.epoch
            and known.finality.header_bytes == proof.finality.header_bytes,
            f"The proof names another epoch {number} than the one that this client entered.",
        )

    def accept(self, proof: FinalityProof) -> Header:
        """Verify a proof, pin its header if newer (R20) and return it.

        Raises PROOF_OTHER_EPOCH (call `advance` first), PROOF_STALE, PROOF_INVALID for a contradiction, and as
        `verify_finality`.
        """
        epoch = decode(proof.header_bytes, Header).epoch
        if epoch < self._epoch.number:
            if proof.header_bytes == self._header_bytes:
                return self._header
            raise self._stale(f"The proof is of epoch {epoch}, which is over.")
        header = verify_finality(proof, self._schedule, self._chain_id, self._round_zero_id)
        if self._is_older(header):
            raise self._stale(f"The proof is about height {header.height}.")
        self._pin(header, proof.header_bytes)
        return header

    def verify_state(self, proof: FinalityProof, key: bytes, value: bytes | None, state_proof: Proof) -> Any:
        """Return the decoded value of a flat key after the proof's header; None if absent.

        `value` is the node's claim (encoded bytes or None). Raises as `accept`, PROOF_INVALID, ENCODING_*.
        """
        header = self.accept(proof)
        verify_proof(header.state_root, key, value, state_proof)
        return None if value is None else decode_value(value)

    def _stale(self, detail: str) -> BlockRobotError:
        return BlockRobotError("PROOF_STALE", f"{detail} Height {self._header.height} was final before.")

    def _is_older(self, header: Header) -> bool:
        pinned = self._header
        return header.height < pinned.height and (header.epoch, header.round) < (pinned.epoch, pinned.round)

    def _pin(self, header: Header, header_bytes: bytes) -> None:
        pinned = self._header
        if header_bytes == self._header_bytes:
            return
        _require(
            header.height > pinned.height and (header.epoch, header.round) > (pinned.epoch, pinned.round),
            "Two contradicting headers are proven final: more producers are faulty than the chain tolerates.",
        )
        self._header, self._header_bytes = header, header_bytes

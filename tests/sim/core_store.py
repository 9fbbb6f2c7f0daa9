"""A simulated node's store: finalized blocks with their certificates, of which a crash leaves the synced ones."""

from __future__ import annotations

from dataclasses import dataclass

from consensus.chain.block import Block, EpochProof, QuorumCertificate, genesis_certificate
from consensus.chain.light_client import verify_finality
from consensus.chain.schedule import Epoch, Schedule, compute_epoch_hash
from tests.sim.named_chain import CHAIN_ID


@dataclass(frozen=True)
class Stored:
    """A finalized block, its certificate, and for a boundary the proof of the epoch that follows it."""

    block: Block
    qc: QuorumCertificate
    epoch_proof: EpochProof | None


class CoreStore:
    """The store of one node. What it is asked about epochs it answers from the synced blocks alone."""

    def __init__(self, genesis: Block, genesis_qc: QuorumCertificate, first_epoch: Epoch) -> None:
        self.synced = [Stored(genesis, genesis_qc, None)]
        self.unsynced: list[Stored] = []
        self._first_epoch = first_epoch

    @property
    def everything(self) -> list[Stored]:
        return [*self.synced, *self.unsynced]

    @property
    def newest(self) -> Block:
        """The newest block, synced or not."""
        return (self.unsynced or self.synced)[-1].block

    @property
    def head(self) -> Block:
        """The newest synced block."""
        return self.synced[-1].block

    @property
    def head_qc(self) -> QuorumCertificate:
        """What certifies the head in the epoch that the store is in (R23)."""
        if self.synced[-1].epoch_proof is not None:
            return genesis_certificate(self.head.block_id, self.epoch.number)
        return self.synced[-1].qc

    @property
    def _boundary(self) -> Stored | None:
        return next((stored for stored in reversed(self.synced) if stored.epoch_proof is not None), None)

    @property
    def epoch(self) -> Epoch:
        """The epoch of the block that comes next."""
        boundary = self._boundary
        return self._first_epoch if boundary is None or boundary.epoch_proof is None else boundary.epoch_proof.epoch

    @property
    def schedule(self) -> Schedule:
        return Schedule.of(self.epoch)

    @property
    def round_zero_id(self) -> bytes:
        boundary = self._boundary
        return (self.synced[0] if boundary is None else boundary).block.block_id

    def block(self, block_id: bytes) -> Block:
        """Return a finalized block."""
        return next(stored.block for stored in reversed(self.everything) if stored.block.block_id == block_id)

    def add(self, stored: Stored) -> None:
        """Take the next finalized block; check the proof of a boundary as a light client would."""
        assert stored.block.header.parent_id == self.newest.block_id
        assert stored.block.header.is_boundary == (stored.epoch_proof is not None)
        if stored.epoch_proof is not None:
            finality, epoch = stored.epoch_proof.finality, stored.epoch_proof.epoch
            assert finality.header_bytes == stored.block.header_bytes
            header = verify_finality(finality, self.schedule, CHAIN_ID, self.round_zero_id)
            assert header.next_schedule_hash == compute_epoch_hash(epoch)
        self.unsynced.append(stored)

    def sync(self, height: int) -> None:
        """Make everything up to a height durable."""
        self.synced += [stored for stored in self.unsynced if stored.block.header.height <= height]
        self.unsynced = [stored for stored in self.unsynced if stored.block.header.height > height]

    def lose_unsynced(self) -> None:
        """The power went off."""
        self.unsynced = []

    def run_above(self, height: int) -> tuple[list[tuple[Block, QuorumCertificate]], EpochProof | None]:
        """Return the finalized blocks above a height, up to the first boundary among them, and its proof."""
        run: list[tuple[Block, QuorumCertificate]] = []
        for stored in self.everything:
            if stored.block.header.height > height:
                run.append((stored.block, stored.qc))
                if stored.epoch_proof is not None:
                    return run, stored.epoch_proof
        return run, None

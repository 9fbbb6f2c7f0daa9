"""A hand-made chain over many epochs, from a real genesis file, with all keys: what clients have to follow."""

from __future__ import annotations

import msgspec

from consensus.chain.block import Block, EpochProof, FinalityProof
from consensus.chain.genesis import GENESIS_VERSION, ChainSettings, Genesis, NodeEntry
from consensus.chain.schedule import Epoch, compute_epoch_hash
from consensus.primitives.hashing import sha256
from tests.sim.named_chain import make_keys
from tests.unit.consensus.one_core import Peers

KEYS = make_keys(10)
GENESIS_FILE = Genesis(
    version=GENESIS_VERSION,
    network="ward",
    created_at_ms=1_800_000_000_000,
    settings=ChainSettings(),
    organisations=(),
    nodes=tuple(
        NodeEntry(
            name=f"n{number}",
            organisation="o",
            host="127.0.0.1",
            p2p_port=1,
            api_url="",
            producer_key=key.public_key,
            producer_possession=b"",
            custodian_key=b"",
        )
        for number, key in enumerate(KEYS[:4])
    ),
    contracts=(),
    purposes=(),
    state_root=sha256(b"genesis state"),
)


def make_epoch(number: int, first_key: int = 0, count: int = 4) -> Epoch:
    """Return an epoch whose producers have `count` of the keys in a row."""
    keys = tuple(key.public_key for key in KEYS[first_key : first_key + count])
    return Epoch(number=number, producers=keys, leaderless=(), settings=ChainSettings())


class ManyEpochs:
    """A chain that grows block by block, one each round; `peers` are the producers of the newest epoch."""

    def __init__(self) -> None:
        self.peers = Peers(root=GENESIS_FILE.block(), chain_id=GENESIS_FILE.chain_id)
        self.blocks = [self.peers.root]

    def grow(self, count: int = 1) -> Block:
        """Add blocks of the next rounds; return the last."""
        for _ in range(count):
            self.blocks.append(self.peers.block(self.next_round, self.blocks[-1]))
        return self.blocks[-1]

    @property
    def next_round(self) -> int:
        head = self.blocks[-1]
        return 1 if head is self.peers.root else head.header.round + 1

    def prove(self, block: Block) -> FinalityProof:
        """Return the proof of a block of the newest epoch, by the child that would come next."""
        peers = self.peers
        round_number = 1 if block is peers.root else block.header.round + 1
        child = (peers.closing if block.header.ends_epoch else peers.block)(round_number, block)
        return FinalityProof(
            header_bytes=block.header_bytes, child_header_bytes=child.header_bytes, child_qc=peers.qc(child)
        )

    def prove_through(self, boundary: Block, *rounds: int) -> FinalityProof:
        """Return the proof of a boundary by closing blocks of these rounds, the last two of which follow each other."""
        closing = [boundary]
        for number in rounds:
            tc = self.peers.tc(number - 1, closing[-1].header.round)
            is_next = number == closing[-1].header.round + 1
            closing.append(self.peers.closing(number, closing[-1], tc=None if is_next else tc))
        return FinalityProof(
            header_bytes=boundary.header_bytes,
            child_header_bytes=closing[-1].header_bytes,
            child_qc=self.peers.qc(closing[-1]),
            through=tuple(block.header_bytes for block in closing[1:-1]),
        )

    def change(self, first_key: int = 0, count: int = 4, *, through: tuple[int, ...] = ()) -> EpochProof:
        """End the epoch with a boundary; return the proof of the next one. `through` are rounds after the boundary's."""
        epoch = make_epoch(self.peers.epoch + 1, first_key, count)
        round_number = self.next_round
        changes = {"next_schedule_hash": compute_epoch_hash(epoch)}
        boundary = self.peers.block(round_number, self.blocks[-1], **changes)  # type: ignore[arg-type]
        rounds = tuple(round_number + after for after in through)
        finality = self.prove_through(boundary, *rounds) if rounds else self.prove(boundary)
        self.blocks.append(boundary)
        self.peers = Peers(
            count, epoch=epoch.number, root=boundary, first_key=first_key, chain_id=GENESIS_FILE.chain_id
        )
        return EpochProof(finality=finality, epoch=epoch)


def renamed(proof: EpochProof, **changes: object) -> EpochProof:
    """Return the proof with other fields in its epoch."""
    return msgspec.structs.replace(proof, epoch=msgspec.structs.replace(proof.epoch, **changes))

"""What a liar sees of its own running node: the production engine and its links."""

from __future__ import annotations

from typing import Protocol

from consensus.chain.block import Header, QuorumCertificate
from consensus.protocol.core import Core
from node.consensus.engine import Engine
from node.p2p.wire import FrameKind


class RawLinks(Protocol):
    """The links of a node, as far as a flood needs them."""

    def broadcast(self, kind: FrameKind, payload: bytes) -> None:
        """Send one payload to all connected peers."""
        ...


class EngineView:
    """`OwnNode` of a node whose engine runs; it follows the engine from one epoch's core to the next."""

    def __init__(self, engine: Engine, chain_id: bytes, links: RawLinks) -> None:
        self._engine = engine
        self._links = links
        self.chain_id = chain_id

    @property
    def _core(self) -> Core:
        return self._engine.core

    @property
    def epoch(self) -> int:
        """The epoch that the node is in."""
        return self._core.epoch

    @property
    def round(self) -> int:
        """The round that the node is in."""
        return self._core.round

    @property
    def index(self) -> int | None:
        """The node's place in the schedule, or None if it has none (now)."""
        return self._core.index

    @property
    def producers_count(self) -> int:
        """How many producers the schedule has."""
        return len(self._core.schedule.producers)

    @property
    def high_qc(self) -> QuorumCertificate:
        """The highest certificate that the node knows."""
        return self._core.high_qc

    def header(self, block_id: bytes) -> Header | None:
        """Return the header of a block that is not final yet, or of the finalized head; None for any other."""
        if block_id == self._core.finalized_id:
            return self._core.finalized
        block = self._core.block(block_id)
        return None if block is None else block.header

    def send_raw(self, kind: int, payload: bytes) -> None:
        """Send bytes as a frame of this kind to all peers, whatever they are."""
        self._links.broadcast(FrameKind(kind), payload)

"""A liar's view of its own running production engine and links."""

from __future__ import annotations

from typing import Protocol

from consensus.chain.block import Header, QuorumCertificate
from consensus.protocol.core import Core
from node.consensus.engine import Engine
from node.p2p.wire import FrameKind


class RawLinks(Protocol):
    """The part of a node's links that floods use."""

    def broadcast(self, kind: FrameKind, payload: bytes) -> None: ...


class EngineView:
    """`OwnNode` of a running engine, followed across epochs."""

    def __init__(self, engine: Engine, chain_id: bytes, links: RawLinks) -> None:
        self._engine = engine
        self._links = links
        self.chain_id = chain_id

    @property
    def _core(self) -> Core:
        return self._engine.core

    @property
    def epoch(self) -> int:
        return self._core.epoch

    @property
    def round(self) -> int:
        return self._core.round

    @property
    def index(self) -> int | None:
        return self._core.index

    @property
    def producers_count(self) -> int:
        return len(self._core.schedule.producers)

    @property
    def high_qc(self) -> QuorumCertificate:
        return self._core.high_qc

    def header(self, block_id: bytes) -> Header | None:
        if block_id == self._core.finalized_id:
            return self._core.finalized
        block = self._core.block(block_id)
        return None if block is None else block.header

    def send_raw(self, kind: int, payload: bytes) -> None:
        self._links.broadcast(FrameKind(kind), payload)

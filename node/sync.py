"""Catching up: fetches finalized blocks from peers, checks and executes them. Must never install what is not proved final.

A batch is a run of blocks above one's own head whose last one a two-chain proof makes final; the ids of the parents
then make all of them final. It never goes beyond a boundary: the next batch is checked with the epoch that the boundary
decided. Every block is executed here and its roots compared before any of them is stored. Short
gaps are the core's own business (it asks for the missing ancestors of what it hears of); long ones are closed here.
"""

from __future__ import annotations

import asyncio
from typing import Protocol

import structlog

from consensus.block import Block, EpochProof, FinalityProof
from consensus.block_rules import check_block
from consensus.errors import BlockRobotError
from consensus.genesis import Genesis
from consensus.light_client import verify_finality
from consensus.primitives.encoding import decode, encode
from consensus.signature_cache import SignatureCache, SignatureCheck
from node.engine import Engine
from node.execution import ExecutedBlock, Executor
from node.finality import FinalityFeed, LedgerWriter
from node.p2p.wire import BlockBatch, FinalizedRequest, RequestKind
from node.storage.ledger_store import LedgerSnapshot, LedgerStore

LAG_TOLERATED_BLOCKS = 32
BATCH_MAX_COUNT = 64
BATCH_MAX_BYTES = 4 * 1024 * 1024
PROOF_SEARCH_MAX_COUNT = 256
RETRY_MS = 500
FRUITLESS_MS = 5_000
INSTALL_TIMEOUT_MS = 30_000

log = structlog.get_logger(__name__)


class Requester(Protocol):
    """Asks peers."""

    async def request(self, peer: str, kind: RequestKind, body: bytes) -> bytes:
        """Return the answer. Raises PEER_UNAVAILABLE."""
        ...


def proof_from_blocks(block: Block, child: Block | None, grandchild: Block | None) -> FinalityProof | None:
    """Return the two-chain proof of a stored block out of the two blocks above it, or None if they make none."""
    if child is None or grandchild is None:
        return None
    header, child_header, qc = block.header, child.header, grandchild.header.qc
    if child_header.round != header.round + 1 or child_header.epoch != header.epoch:
        return None
    if qc.block_id != child.block_id or qc.epoch != header.epoch:
        return None
    return FinalityProof(header_bytes=block.header_bytes, child_header_bytes=child.header_bytes, child_qc=qc)


def finality_of(snapshot: LedgerSnapshot, height: int) -> FinalityProof | None:
    """Return the proof that the stored block of this height is final, if it has one of its own."""
    position = snapshot.position
    if position is not None and position.height == height:
        return decode(snapshot.finality, FinalityProof) if snapshot.finality else None
    found = [snapshot.block(height + offset) for offset in range(3)]
    block, child, grandchild = (None if data is None else decode(data, Block) for data in found)
    if block is None:
        return None
    return boundary_proof(snapshot, block) or proof_from_blocks(block, child, grandchild)


def boundary_proof(snapshot: LedgerSnapshot, block: Block) -> FinalityProof | None:
    """Return the proof of a stored boundary, which began the next epoch, or None for any other block."""
    header = block.header
    if header.next_schedule_hash is None:
        return None
    data = snapshot.epoch_proof(header.epoch + 1)
    return None if data is None else decode(data, EpochProof).finality


def read_batch(snapshot: LedgerSnapshot, from_height: int) -> BlockBatch:
    """Return the run of stored blocks of one epoch from a height on that fits a message and ends with a provable one."""
    blocks: list[bytes] = []
    provable, proof, size = 0, None, 0
    for height, data in snapshot.iter_blocks(from_height, PROOF_SEARCH_MAX_COUNT):
        size += len(data)
        if provable and (size > BATCH_MAX_BYTES or len(blocks) >= BATCH_MAX_COUNT):
            break
        blocks.append(data)
        found = finality_of(snapshot, height)
        if found is not None:
            provable, proof = len(blocks), found
        if decode(data, Block).header.next_schedule_hash is not None:
            break
    return BlockBatch(blocks=tuple(blocks[:provable]), proof=proof)


class Synchroniser:
    """Keeps a node that is far behind catching up until it is not."""

    def __init__(
        self,
        *,
        genesis: Genesis,
        ledger: LedgerStore,
        engine: Engine,
        executor: Executor,
        writer: LedgerWriter,
        feed: FinalityFeed,
        requester: Requester,
        check: SignatureCheck | None = None,
    ) -> None:
        self._genesis = genesis
        self._ledger = ledger
        self._engine = engine
        self._executor = executor
        self._writer = writer
        self._feed = feed
        self._requester = requester
        self._heights: dict[str, int] = {}
        self._epochs: dict[str, int] = {}
        self._fruitless: dict[str, float] = {}
        self._has_proof = False
        self._check = SignatureCache() if check is None else check
        self._task: asyncio.Task[None] | None = None
        self.blocks_installed_count = 0

    @property
    def is_running(self) -> bool:
        """Tell whether the node is catching up."""
        return self._task is not None and not self._task.done()

    @property
    def closes_gap(self) -> bool:
        """Tell whether a gap that a peer has proved is being closed; what peers only claim does not count."""
        return self.is_running and self._has_proof

    @property
    def lag_blocks(self) -> int:
        """How many blocks the peers say that this node is behind the one that is farthest ahead (0 or more)."""
        return max(0, max(self._heights.values(), default=0) - self._writer.queued_height)

    def note_height(self, peer: str, height: int) -> None:
        """A peer said how far it is: begin to catch up if that is far ahead."""
        self._heights[peer] = height
        if height > self._writer.queued_height + LAG_TOLERATED_BLOCKS:
            self._begin()

    def note_epoch(self, peer: str, epoch: int) -> None:
        """A peer is in a later epoch: catch up with it, however short the gap. Not soon again if it had nothing."""
        until = self._fruitless.get(peer)
        if epoch > self._engine.epoch.number and (until is None or asyncio.get_running_loop().time() >= until):
            self._epochs[peer] = epoch
            self._begin()

    def _begin(self) -> None:
        if not self.is_running:
            self._has_proof = False
            self._task = asyncio.get_running_loop().create_task(self._run(), name="sync")

    def forget(self, peer: str) -> None:
        """A peer is gone."""
        self._heights.pop(peer, None)
        self._epochs.pop(peer, None)

    def _set_aside(self, peer: str) -> None:
        """A peer had nothing that helps: do not ask it again for a while because of its epoch."""
        self.forget(peer)
        self._fruitless[peer] = asyncio.get_running_loop().time() + FRUITLESS_MS / 1000

    def _choose_peer(self) -> str | None:
        """Return the peer to ask next: one of a later epoch, or else the one that is farthest ahead; None if done."""
        epoch, height = self._engine.epoch.number, self._writer.queued_height
        later = [peer for peer, number in self._epochs.items() if number > epoch]
        far = [peer for peer, reached in self._heights.items() if reached > max(self._feed.height, height + 1)]
        ahead = later or far
        return max(ahead, key=lambda peer: (self._heights.get(peer, 0), peer)) if ahead else None

    async def stop(self) -> None:
        """Stop catching up."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)

    def serve(self, body: bytes) -> bytes:
        """Answer a peer's request for finalized blocks. Raises ENCODING_*."""
        request = decode(body, FinalizedRequest)
        with self._ledger.snapshot() as snapshot:
            return encode(read_batch(snapshot, max(1, request.from_height)))

    async def _run(self) -> None:
        log.info("sync_started", height=self._writer.queued_height)
        while True:
            peer = self._choose_peer()
            if peer is None:
                break
            try:
                await self._advance(peer)
            except BlockRobotError as error:
                log.warning("sync_failed", peer=peer, code=error.code, detail=error.detail)
                self._set_aside(peer)
                await asyncio.sleep(RETRY_MS / 1000)
        log.info("sync_finished", height=self._feed.height, blocks=self.blocks_installed_count)

    async def _advance(self, peer: str) -> None:
        """Fetch, check, execute and install one batch of one peer."""
        if self._feed.height < self._writer.queued_height:
            await self._feed.wait_above(self._writer.queued_height - 1, INSTALL_TIMEOUT_MS)
        request = FinalizedRequest(from_height=self._feed.height + 1)
        answer = await self._requester.request(peer, RequestKind.FINALIZED, encode(request))
        batch = decode(answer, BlockBatch)
        blocks = [decode(data, Block) for data in batch.blocks]
        if not blocks or batch.proof is None:
            self._set_aside(peer)
            return
        self._check_batch(blocks, batch.proof)
        self._has_proof = True
        executed: list[ExecutedBlock] = []
        for block in blocks:
            executed.append(await self._execute(block))
            await asyncio.sleep(0)
        self._writer.store(
            [block for block in executed if block.header.height > self._writer.queued_height], batch.proof
        )
        if not await self._feed.wait_above(blocks[-1].header.height - 1, INSTALL_TIMEOUT_MS):
            raise BlockRobotError("STORAGE_UNWRITABLE", "The ledger did not take the blocks in time.")
        self.blocks_installed_count += len(blocks)

    def _check_batch(self, blocks: list[Block], proof: FinalityProof) -> None:
        """Check that the blocks follow one another above the head, in its epoch, and that the last one is final."""
        chain_id, start = self._genesis.chain_id, self._engine.epoch
        verify_finality(proof, start.schedule, chain_id, start.round_zero_id)
        if proof.header_bytes != blocks[-1].header_bytes:
            raise BlockRobotError("CERTIFICATE_INVALID", "The proof is not for the last block of the batch.")
        with self._ledger.snapshot() as snapshot:
            position = snapshot.position
        if position is None:
            raise AssertionError("the ledger holds genesis")
        parent_id, height = position.block_id, position.height
        for place, block in enumerate(blocks, start=1):
            header = block.header
            height += 1
            if header.is_closing or (header.next_schedule_hash is not None and place < len(blocks)):
                raise BlockRobotError("BLOCK_INVALID", "The peer's blocks go on behind a boundary.")
            if header.parent_id != parent_id or header.height != height:
                raise BlockRobotError("BLOCK_INVALID", "The peer's blocks do not follow one another.")
            check_block(
                block,
                header,
                chain_id=chain_id,
                schedule=start.schedule,
                round_zero_id=start.round_zero_id,
                check=self._check,
            )
            parent_id = block.block_id

    async def _execute(self, block: Block) -> ExecutedBlock:
        """Execute a block between two events of the core. Raises what `Executor.verify` raises."""
        done: asyncio.Future[ExecutedBlock] = asyncio.get_running_loop().create_future()

        def execute() -> None:
            if done.cancelled():
                return
            try:
                done.set_result(self._executor.verify(block))
            except Exception as error:  # noqa: BLE001 - handed to the one who waits
                done.set_exception(error)

        self._engine.call_between_events(execute)
        try:
            return await done
        except LookupError:
            raise BlockRobotError("BLOCK_INVALID", "The head moved while the batch was being executed.") from None

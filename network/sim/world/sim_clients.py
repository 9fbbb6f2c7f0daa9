"""Simulated clients: submit signed calls, wait, retry elsewhere, and remember the answers."""

from __future__ import annotations

import itertools
import random
from collections.abc import Callable, Iterator

from consensus.chain.block import Receipts
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode
from consensus.primitives.hashing import sha256
from consensus.state import records
from network.sim.contract_workload import contract_turnover
from network.sim.history import Acknowledged, Asked, ClipTaken, CodeFault, Submitted, ValueRead
from network.sim.plan import NetworkSize
from network.sim.workload import (
    CUSTODY_TURNOVERS_COUNT,
    Call,
    custody_turnover,
    enrolment,
    growth,
    producer_turnover,
    setting_change,
    visit,
)
from network.sim.world.cpu import COSTS, charge
from network.sim.world.sim_node import SimNode
from network.sim.world.sim_world import SimWorld
from node.custody.chain_facts import read_placement

REQUEST_DELAY_MS = (0.2, 4.0)
WAIT_MS = 1_500
PATIENCE_MS = 2_500.0
RETRY_MS = (20.0, 250.0)
READ_SHARE = 0.2
UPLOAD_SHARE = 0.75
GONE = -1
"""Among who has taken a clip: nobody else has to."""
READ_KEY = records.ANNOUNCEMENT_COUNT.flat


def decisions_of(size: NetworkSize, governance: str, seed: int = 0) -> Iterator[tuple[Call, ...]]:
    """Endlessly; some end an epoch, or two."""
    if governance == "custody":
        yield from custody_turnover(size, seed % CUSTODY_TURNOVERS_COUNT)
        for number in itertools.count(CUSTODY_TURNOVERS_COUNT):
            yield from custody_turnover(size, number)
    decide = {
        "settings": setting_change,
        "producers": producer_turnover,
        "grow": growth,
        "contracts": contract_turnover,
    }[governance]
    for number in itertools.count():
        yield from decide(size, number)


def batches_of(size: NetworkSize, client: int) -> Iterator[tuple[Call, ...]]:
    yield (enrolment(size, client),)
    number = 0
    while True:
        yield from visit(size, client, number)
        number += 1


class SimClient:
    """Runs its batches one after another, with gaps, until stopped."""

    def __init__(
        self,
        cluster: SimWorld,
        nodes: list[SimNode],
        dice: random.Random,
        batches: Iterator[tuple[Call, ...]],
        gap_ms: tuple[float, float],
        may_begin: Callable[[tuple[Call, ...]], bool] = lambda _batch: True,
    ) -> None:
        self.cluster, self.nodes, self.dice = cluster, nodes, dice
        self.is_stopping = False
        self._batches, self._gap_ms, self._may_begin = batches, gap_ms, may_begin
        self._takers: dict[bytes, set[int]] = {}
        self.begun_ms, self.begun_count = 0.0, 0
        self._open: dict[bytes, Call] = {}
        self.acknowledged_count = 0

    @property
    def is_idle(self) -> bool:
        return not self._open

    def start(self) -> None:
        self._next()

    def _later(self, delay_ms: float, action: Callable[[], None]) -> None:
        loop = self.cluster.loop
        loop.call_for(loop.stage, loop.time() + delay_ms / 1000, action)

    def _travel(self, action: Callable[[], None]) -> None:
        self._later(self.dice.uniform(*REQUEST_DELAY_MS), action)

    def _next(self) -> None:
        if not self.is_stopping:
            self._begin(next(self._batches))

    def _begin(self, batch: tuple[Call, ...]) -> None:
        if self.is_stopping:
            return
        if self._seats() < max(call.seats for call in batch) or not self._may_begin(batch):
            self._later(self.dice.uniform(*RETRY_MS), lambda: self._begin(batch))
            return
        self.begun_ms, self.begun_count = self.cluster.loop.now_ms, self.begun_count + 1
        self._open = {call.transaction.txid: call for call in batch}
        for call in batch:
            if call.upload is not None:
                self._upload(call)
            self._try(call)

    def _seats(self) -> int:
        epochs = [node.parts.engine.epoch for node in self.nodes if node.is_serving and node.parts is not None]
        return len(max(epochs, key=lambda start: start.number).epoch.producers) if epochs else 0

    def _choose(self) -> SimNode | None:
        serving = [node for node in self.nodes if node.is_serving]
        return self.dice.choice(serving) if serving else None

    def _upload(self, call: Call) -> None:
        if self.cluster.plan.size.all_keep:
            self._deliver(call)
            return
        for node in self.nodes:
            if node.custody_key is not None and self.dice.random() < UPLOAD_SHARE:
                self._travel(lambda node=node: self._stage(node, call))  # type: ignore[misc]

    def _deliver(self, call: Call) -> None:
        """Until as many as keep a clip have taken it, as a robot does: its keepers, and for one that is away the next."""
        node, upload = self._choose(), call.upload
        if upload is None or (self.is_stopping and call.transaction.txid not in self._open):
            return
        taken = self._takers.setdefault(upload.record_id, set())
        self._later(self.dice.uniform(*RETRY_MS), lambda: self._deliver(call) if GONE not in taken else None)
        if node is None:
            return
        with node.ledger.snapshot() as snapshot:
            placement = read_placement(snapshot)
        ranked = [self.cluster.custodian_nodes[key] for key in placement.rank(upload.record_id)]
        free = [self.nodes[index] for index in ranked if index not in taken and self.nodes[index].is_serving]
        for each in free[: max(0, placement.count - len(taken))]:
            self._travel(lambda each=each: self._stage(each, call))  # type: ignore[misc]
        if len(taken) >= placement.count:
            taken.add(GONE)

    def _stage(self, node: SimNode, call: Call) -> None:
        parts = node.parts
        if not node.is_serving or parts is None or parts.custody is None or call.upload is None:
            return
        custody, upload, sender = parts.custody, call.upload, call.transaction.body.sender

        async def stage() -> None:
            charge(COSTS.call)
            try:
                async with custody.admission.clip(upload.record_id, upload.owner, upload.size_bytes, sender) as new:
                    await custody.stage(upload, sender, is_new=new)
            except BlockRobotError as error:
                if error.code == "CLIP_ERASED":
                    self._takers.setdefault(upload.record_id, set()).add(GONE)
                return
            self._takers.setdefault(upload.record_id, set()).add(node.index)
            self.cluster.history.add(ClipTaken(self.cluster.now, node.index, upload.record_id))

        self.cluster.run_on(node.owner, stage)

    def _try(self, call: Call) -> None:
        if call.transaction.txid not in self._open:
            return
        node = self._choose()
        if node is not None:
            self.cluster.history.add(Asked(self.cluster.now, node.index, call.transaction.txid))
            self._travel(lambda: self._submit(node, call))
        self._later(PATIENCE_MS * self.dice.uniform(0.3, 1.0), lambda: self._try(call))

    def _submit(self, node: SimNode, call: Call) -> None:
        parts, transaction = node.parts, call.transaction
        if not node.is_serving or parts is None:
            return
        cluster = self.cluster

        async def submit() -> None:
            charge(COSTS.call)
            result = (await parts.pool.submit([transaction.wire]))[0]
            code = "" if result.error is None else result.error.code
            cluster.history.add(Submitted(cluster.now, node.index, transaction.txid, code))
            if code not in {"", "TRANSACTION_REPLAYED"}:
                return
            is_final = not code and await parts.pool.wait_final(transaction.txid, WAIT_MS)
            with node.ledger.snapshot() as snapshot:
                place = snapshot.locate(transaction.txid)
                if place is None:
                    if is_final:
                        text = f"said that transaction {transaction.txid.hex()[:8]} is final, and its ledger lacks it"
                        cluster.history.add(CodeFault(cluster.now, node.index, text))
                    return
                if place.height < snapshot.earliest_height:
                    return  # pruned, or older than the snapshot that this node began with: another node is asked
                block, receipts = snapshot.block(place.height), snapshot.receipts(place.height)
            if block is None or receipts is None:
                raise AssertionError("the ledger locates a transaction in a block that it does not hold")
            receipt = decode(receipts, Receipts).receipts[place.index]
            block_id = cluster.id_of(block)
            answer = Acknowledged(
                at_ms=cluster.now,
                node=node.index,
                txid=transaction.txid,
                height=place.height,
                block_id=block_id,
                ok=receipt.ok,
                code=receipt.code,
                excused=call.excused,
            )
            self._travel(lambda: self._hear(node, answer))

        cluster.run_on(node.owner, submit)

    def _hear(self, node: SimNode, answer: Acknowledged) -> None:
        self.cluster.history.add(answer)
        if self._open.pop(answer.txid, None) is not None:
            self.acknowledged_count += 1
            if self.dice.random() < READ_SHARE:
                self._travel(lambda: self._read(node))
            if not self._open:
                self._later(self.dice.uniform(*self._gap_ms), self._next)

    def _read(self, node: SimNode) -> None:
        if not node.is_serving:
            return
        with node.ledger.snapshot() as snapshot:
            value, position = snapshot.get(READ_KEY), snapshot.position
        if position is not None:
            root, digest = position.state_root, sha256(value or b"")
            self.cluster.history.add(ValueRead(self.cluster.now, node.index, READ_KEY, position.height, root, digest))

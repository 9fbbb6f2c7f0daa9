"""State shared by simulated nodes, clients and faults: loop, links, chain, history."""

from __future__ import annotations

import random
from collections import OrderedDict
from collections.abc import Callable, Coroutine
from typing import Any

from consensus.chain.block import Block, Header
from consensus.primitives.encoding import decode
from network.byzantine import ColludingNodes
from network.sim.history import ExecutionDiffered, History, PeerCutOff
from network.sim.plan import PROFILES, Plan
from network.sim.world.links import LinkQuality, Wires
from network.sim.world.sim_chain import make_chain, node_name
from network.sim.world.sim_machine import ComparingMachine
from network.sim.world.virtual_time import Owner, SimLoop
from node.storage.ledger_store import FinalizedBlock

HEADERS_KEPT_COUNT = 4_096

_headers: OrderedDict[bytes, Header] = OrderedDict()


class SimWorld:
    """The stage on which one plan is played."""

    def __init__(self, plan: Plan, history: History) -> None:
        self.plan, self.history = plan, history
        self.chain = make_chain(plan.size)
        self.loop = SimLoop(plan.seed)
        self.machine = ComparingMachine(
            self.chain.machine, shares=not plan.executes_apart, on_difference=self._note_difference
        )
        self.dice = random.Random(f"run {plan.seed}")  # noqa: S311 - a simulation's dice
        self.accomplices = ColludingNodes()
        self.owners: list[Owner] = [self.loop.stage]
        self.custodian_nodes = {
            key.public_key: index for index, key in enumerate(self.chain.custodians) if key is not None
        }
        self._indexes = {node_name(index): index for index in range(plan.nodes)}
        self.wires = Wires(self.loop, self.own_dice("wires"), self._note_frame, self._note_cut_off)
        self.wires.quality = LinkQuality(**PROFILES[plan.profile])
        self.is_healed = False
        self._final_rounds: dict[int, int] = {}

    def own_dice(self, name: str) -> random.Random:
        return random.Random(f"{name} of {self.plan.seed}")  # noqa: S311 - a simulation's dice

    @property
    def now(self) -> float:
        return round(self.loop.now_ms, 6)

    @property
    def rounds(self) -> int:
        return sum(self._final_rounds.values())

    def note_final(self, header: Header) -> None:
        self._final_rounds[header.epoch] = max(self._final_rounds.get(header.epoch, 0), header.round)

    def run_on(self, owner: Owner, work: Callable[[], Coroutine[Any, Any, None]]) -> None:
        self.loop.call_for(owner, self.loop.time(), lambda: self.loop.create_task(work()))

    def header_of(self, block: FinalizedBlock) -> Header:
        known = _headers.get(block.block_id)
        if known is None:
            known = _headers[block.block_id] = decode(block.block_bytes, Block).header
            if len(_headers) > HEADERS_KEPT_COUNT:
                _headers.popitem(last=False)
        return known

    def id_of(self, block_bytes: bytes) -> bytes:
        return decode(block_bytes, Block).block_id

    def _note_frame(self, sender: str, receiver: str, kind: int, payload: bytes) -> None:
        self.history.note_frame(self.now, self._indexes[sender], self._indexes[receiver], kind, payload)

    def _note_cut_off(self, name: str, peer: str, code: str) -> None:
        self.history.add(PeerCutOff(self.now, self._indexes[name], self._indexes[peer], code))

    def _note_difference(self, height: int, text: str) -> None:
        self.history.add(ExecutionDiffered(self.now, -1, height, text))

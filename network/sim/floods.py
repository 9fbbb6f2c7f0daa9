"""Flooding members: genuine links, frames cheap to send and expensive to handle."""

from __future__ import annotations

import random

from consensus.chain.messages import LastSignedRequest
from consensus.chain.transaction import SALT_SIZE_BYTES, TransactionWire, sign_transaction
from consensus.limits import TRANSACTION_LIFETIME_MAX_MS
from consensus.primitives.encoding import encode
from network.sim.history import Flooded
from network.sim.plan import Fault, max_faulty
from network.sim.world.links import KIB, SimNetwork
from network.sim.world.sim_chain import EPOCH_MS, make_key
from network.sim.world.sim_node import SimNode
from network.sim.world.sim_world import SimWorld
from network.sim.world.virtual_time import Owner
from node.p2p.wire import FinalizedRequest, FrameKind, HeightNotice, RequestKind, TransactionBatch

WINDOW_BYTES = 1024 * 1024
TRANSACTIONS_A_FRAME_COUNT = 256
RANGE_ASKED_COUNT = 64
REQUEST_NUMBER = -1
MESSAGE_SIZE_BYTES = 32
"""What a small message takes on the wire, its head and its seal among it."""


class Flood:
    """One active `flood` fault; its content is drawn from the plan's seed."""

    def __init__(self, cluster: SimWorld, node: SimNode, fault: Fault) -> None:
        self._cluster, self._node, self._fault = cluster, node, fault
        self._dice = random.Random(f"flood {cluster.plan.seed} {fault}")  # noqa: S311 - a simulation's dice
        self._until_ms = cluster.loop.now_ms + fault.for_ms
        self._unhandled_bytes: dict[Owner, int] = {}
        self._template = b""

    def start(self) -> None:
        plan = self._cluster.plan
        flooding = {fault.node for fault in plan.faults} | set(plan.byzantine_nodes)
        is_alone = all(fault.kind == "flood" for fault in plan.faults)
        if is_alone and len(flooding) <= max_faulty(plan.size.producers):
            self._cluster.history.add(
                Flooded(self._cluster.now, self._node.index, round(self._until_ms, 6), self._fault.point)
            )
        self._send()

    def _send(self) -> None:
        cluster, network = self._cluster, self._node.network
        if cluster.is_healed or cluster.loop.now_ms >= self._until_ms:
            return
        size = MESSAGE_SIZE_BYTES
        if self._node.is_serving and network is not None:
            kind, payload = self._next_message()
            size += len(payload)
            for peer in network.connected:
                self._send_to(network, peer, kind, payload)
        delay_s = size / (self._fault.amount * KIB)
        cluster.loop.call_for(cluster.loop.stage, cluster.loop.time() + delay_s, self._send)

    def _send_to(self, network: SimNetwork, peer: str, kind: FrameKind, payload: bytes) -> None:
        life, size = network.lives.get(peer), len(payload) + MESSAGE_SIZE_BYTES
        if life is None or self._unhandled_bytes.get(life, 0) + size > WINDOW_BYTES:
            return
        self._unhandled_bytes[life] = self._unhandled_bytes.get(life, 0) + size

        def handled() -> None:
            self._unhandled_bytes[life] -= size

        wires = network.wires
        if kind is FrameKind.REQUEST:
            wires.ask(network, peer, REQUEST_NUMBER, RequestKind.FINALIZED, payload, handled)
        else:
            wires.carry(network, peer, kind, payload, handled)

    def _next_message(self) -> tuple[FrameKind, bytes]:
        match self._fault.point:
            case "ranges":
                request = FinalizedRequest(from_height=1 + self._dice.randrange(4), count=RANGE_ASKED_COUNT)
                return FrameKind.REQUEST, encode(request)
            case "heights":
                return FrameKind.HEIGHT, encode(HeightNotice(finalized_height=1, epoch=0))
            case "words":
                parts = self._node.parts
                epoch = 0 if parts is None else parts.core.epoch
                return FrameKind.LAST_SIGNED_REQUEST, encode(
                    LastSignedRequest(epoch=epoch, asked_at_ms=self._dice.randrange(1 << 40))
                )
            case _:
                wires = tuple(self._next_transaction() for _ in range(TRANSACTIONS_A_FRAME_COUNT))
                return FrameKind.TRANSACTIONS, encode(TransactionBatch(transactions=wires))

    def _next_transaction(self) -> bytes:
        if not self._template:
            is_expired = self._fault.point == "expired-transactions"
            lives_ms = -1 if is_expired else TRANSACTION_LIFETIME_MAX_MS // 2
            made = sign_transaction(
                make_key("robot 0"),
                chain_id=self._cluster.chain.genesis.chain_id,
                contract="records",
                entry="close_visit",
                arguments=[make_key("nobody").public_key, 1],
                valid_until_ms=EPOCH_MS + lives_ms,
                salt=bytes(SALT_SIZE_BYTES),
            )
            self._template = made.body_bytes
            self._signature = made.signature
        body = self._template[:-SALT_SIZE_BYTES] + self._dice.randbytes(SALT_SIZE_BYTES)
        return encode(TransactionWire(body=body, signature=self._signature))

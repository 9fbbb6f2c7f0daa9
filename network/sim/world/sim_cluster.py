"""A whole simulated network on one loop: nodes, links, clients, and a plan's faults."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from typing import Any

import structlog

from network.sim.audit import audit_chain, audit_custody, placement_of
from network.sim.floods import Flood
from network.sim.history import CodeFault, Ended, FaultBegan, Healed, History
from network.sim.plan import PROFILES, Fault, Plan
from network.sim.workload import Call, custody_turnover
from network.sim.world.cpu import charging
from network.sim.world.links import LinkQuality
from network.sim.world.sim_chain import node_name
from network.sim.world.sim_clients import SimClient, batches_of, decisions_of
from network.sim.world.sim_node import Backup, SimNode
from network.sim.world.sim_world import SimWorld
from network.sim.world.virtual_time import Owner

CLIENTS_COUNT = 3
GAP_MS = (0.0, 5.0)
CUSTODY_GAP_MS = (20.0, 200.0)
"""Of robots, where repairs take seconds and clips are few enough to look at all of them."""
DECISION_GAP_MS = (20.0, 300.0)
START_SPREAD_MS = 40.0
ARMED_MAX_MS = 1_500
HEALED_MAX_S = 60.0
SETTLE_MAX_S = 90.0
MORE_ROUNDS_MAX_S = 120.0
DISK_SYNC_MS = 0.05
STORE_SYNC_MS = 4.0


class SimCluster(SimWorld):
    """The world with its nodes and clients; one object plays one plan once."""

    def __init__(self, plan: Plan, history: History) -> None:
        super().__init__(plan, history)
        self.nodes = [SimNode(self, index, self.own_dice(f"node {index}")) for index in range(plan.nodes)]
        for index, behaviour in plan.byzantine_nodes.items():
            self.nodes[index].behaviour = behaviour
        history.byzantine = frozenset(plan.byzantine_nodes)
        gap_ms = CUSTODY_GAP_MS if plan.size.all_keep else GAP_MS
        self.clients = [
            SimClient(self, self.nodes, self.own_dice(f"client {number}"), batches_of(plan.size, number), gap_ms)
            for number in range(CLIENTS_COUNT)
        ]
        if plan.governance:
            decisions = decisions_of(plan.size, plan.governance, plan.seed)
            dice = self.own_dice("organisations")
            self.clients.append(SimClient(self, self.nodes, dice, decisions, DECISION_GAP_MS, self._may_decide))
        self._waiting_since_ms = math.inf
        self._partitions: list[tuple[tuple[int, ...], ...]] = []
        self._one_way: list[tuple[int, int]] = []

    @property
    def honest(self) -> list[SimNode]:
        return [node for node in self.nodes if not node.behaviour and not node.is_lost]

    def run(self) -> None:
        with charging(self.loop) if self.plan.cpu else nullcontext():
            self._play()

    def _play(self) -> None:
        loop, plan = self.loop, self.plan
        for node in self.nodes:
            self._at(self.dice.uniform(0, START_SPREAD_MS), node.start)
        for client in self.clients:
            self._at(self.dice.uniform(0, 2 * START_SPREAD_MS), client.start)
        for fault in plan.faults:
            self._at(fault.at_ms, lambda fault=fault: self._begin(fault))  # type: ignore[misc]
        loop.run_until(lambda: False, plan.horizon_ms / 1000)
        self.heal()
        goal = max(node.ledger_height for node in self.honest) + 2
        loop.run_until(lambda: self._lowest() >= goal, loop.time() + HEALED_MAX_S)
        reached = loop.run_until(self._has_played_all, loop.time() + MORE_ROUNDS_MAX_S)
        for client in self.clients:
            client.is_stopping = True
        settled = loop.run_until(self._is_settled, loop.time() + SETTLE_MAX_S)
        for node in self.honest:
            node.note_faults()
            audit_custody(node)
        audit_chain(self.honest, self.custodian_nodes, self.now, self.history)
        heights = tuple(node.ledger_height for node in self.nodes)
        rounds = tuple(-1 if node.parts is None else node.parts.core.round for node in self.nodes)
        loop.end(self.owners)
        for node in self.nodes:
            node.store.close()
        if self.wires.storm_at_ms is not None:
            text = "A storm: nodes answer each other without end."
            self.history.add(CodeFault(round(self.wires.storm_at_ms, 6), -1, text))
        for text in loop.faults:
            self.history.add(CodeFault(self.now, -1, text))
        self.history.add(Ended(self.now, -1, heights, rounds, settled, reached))

    def _at(self, at_ms: float, action: Callable[[], None]) -> None:
        self.loop.call_for(self.loop.stage, at_ms / 1000, action)

    def _after(self, delay_ms: float, action: Callable[[], None]) -> None:
        self._at(self.loop.now_ms + delay_ms, action)

    def _lowest(self) -> int:
        return min(node.ledger_height for node in self.honest)

    def _has_played_all(self) -> bool:
        is_over = not self.plan.size.all_keep or self.clients[-1].begun_count > len(custody_turnover(self.plan.size, 0))
        return is_over and self.rounds >= self.plan.rounds

    def _is_settled(self) -> bool:
        if not all(client.is_idle for client in self.clients):
            return False
        heights = {node.ledger_height for node in self.honest}
        return (
            len(heights) == 1
            and all(
                node.parts is not None
                and not len(node.parts.mempool)
                and (node.parts.custody is None or node.parts.custody.checkpoint_height == node.ledger_height)
                for node in self.honest
            )
            and self._is_repaired()
            and (not self.plan.size.all_keep or self._owes_nothing())
        )

    # Custodians that come and go

    def _may_decide(self, batch: tuple[Call, ...]) -> bool:
        """One custodian goes at a time, once all robots have begun something new and every keeper has its clips."""
        if not batch[0].after_repair:
            return True
        self._waiting_since_ms = min(self._waiting_since_ms, self.loop.now_ms)
        if (
            any(robot.begun_ms <= self._waiting_since_ms for robot in self.clients[:CLIENTS_COUNT])
            or not self._is_repaired()
        ):
            return False
        self._waiting_since_ms = math.inf
        if batch[0].dying >= 0:
            self.nodes[batch[0].dying].lose()
        return True

    def _is_repaired(self) -> bool:
        """Of each final record's clip that a custodian has, its keepers by the newest block have theirs, and say so."""
        placement = placement_of(self.honest)
        held = {node.member: node.store.holdings() for node in self.honest if node.member in placement.rooms}
        gone = {record_id for each in held.values() for record_id in each.erased}
        kept = {key: {*each.confirmed, *each.staged}.difference(each.missing) for key, each in held.items()}
        return all(
            record_id in kept.get(keeper, (record_id,))
            for record_id in sorted({record_id for each in held.values() for record_id in each.confirmed} - gone)
            for keeper in placement.keepers(record_id)
        )

    def _owes_nothing(self) -> bool:
        members = placement_of(self.honest).rooms
        return not any(node.store.holdings().owed for node in self.honest if node.member in members)

    # Faults

    def _begin(self, fault: Fault) -> None:
        self.history.add(FaultBegan(self.now, fault.node, str(fault)))
        node = self.nodes[fault.node] if 0 <= fault.node < len(self.nodes) else None
        match fault.kind:
            case "power-cut":
                for each in self.nodes:
                    each.crash("power-cut")
                    self._after(fault.for_ms * self.dice.uniform(0.5, 1.0), each.start)
            case "partition":
                self._partitions.append(fault.groups)
                self._refresh_cuts()
                self._after(fault.for_ms, lambda: self._end_partition(fault))
            case "one-way":
                self._one_way.append((fault.node, fault.peer))
                self._refresh_cuts()
                self._after(fault.for_ms, lambda: self._end_one_way(fault))
            case "links":
                self.wires.quality = LinkQuality(**PROFILES[fault.profile])
                self._after(fault.for_ms, self._restore_links)
            case _ if node is not None:
                self._begin_at(node, fault)

    def _begin_at(self, node: SimNode, fault: Fault) -> None:
        match fault.kind:
            case "crash":
                back = lambda: self._after(fault.for_ms, node.start)  # noqa: E731
                life = node.owner
                node.arm(fault.point, back)
                self._after(ARMED_MAX_MS, lambda: self._give_up(node, life, back))
            case "old-disk":
                backup = node.back_up()
                self._after(fault.amount, lambda: self._put_back(node, backup, fault))
            case "pause":
                owner = node.owner
                self.loop.pause(owner)
                self._after(fault.for_ms, lambda: self.loop.resume(owner))
            case "skew":
                node.clock_offset_ms = fault.amount
                self._after(fault.for_ms, lambda: setattr(node, "clock_offset_ms", 0))
            case "slow-disk":
                node.disk.sync_ms = fault.amount
                self._after(fault.for_ms, lambda: setattr(node.disk, "sync_ms", DISK_SYNC_MS))
            case "slow-store":
                node.ledger.sync_max_ms = fault.amount
                self._after(fault.for_ms, lambda: setattr(node.ledger, "sync_max_ms", STORE_SYNC_MS))
            case "flood":
                Flood(self, node, fault).start()
            case "full-disk":
                node.disk.is_full = node.ledger.is_full = True
                self._after(fault.for_ms, lambda: self._free_disk(node))

    def _give_up(self, node: SimNode, life: Owner, back: Callable[[], None]) -> None:
        if node.owner is life and node.is_up:
            node.crash("crash")
            back()

    def _put_back(self, node: SimNode, backup: Backup, fault: Fault) -> None:
        node.crash("old-disk")
        node.restore(backup, whole=fault.point == "machine")
        self._after(fault.for_ms, node.start)

    def _free_disk(self, node: SimNode) -> None:
        node.disk.is_full = node.ledger.is_full = False
        if not node.is_up and not self.is_healed:
            self._after(1, node.start)

    def _end_partition(self, fault: Fault) -> None:
        if fault.groups in self._partitions:
            self._partitions.remove(fault.groups)
            self._refresh_cuts()
            self.wires.reconnect_all()

    def _end_one_way(self, fault: Fault) -> None:
        if (fault.node, fault.peer) in self._one_way:
            self._one_way.remove((fault.node, fault.peer))
            self._refresh_cuts()
            self.wires.break_connection(node_name(fault.node), node_name(fault.peer))

    def _restore_links(self) -> None:
        if not self.is_healed:
            self.wires.quality = LinkQuality(**PROFILES[self.plan.profile])

    def _refresh_cuts(self) -> None:
        names = [node.name for node in self.nodes]
        cut = {(names[first], names[second]) for first, second in self._one_way}
        for groups in self._partitions:
            side = {index: number for number, group in enumerate(groups) for index in group}
            cut |= {
                (names[first], names[second])
                for first in range(len(names))
                for second in range(len(names))
                if side.get(first, -1) != side.get(second, -1)
            }
        self.wires.cut = cut

    def heal(self) -> None:
        self.is_healed = True
        self._partitions, self._one_way = [], []
        self._refresh_cuts()
        self.wires.quality = LinkQuality(**PROFILES["lan"])
        for node in self.nodes:
            node.disarm()
            node.disk.is_full = node.ledger.is_full = False
            node.disk.sync_ms, node.ledger.sync_max_ms = DISK_SYNC_MS, STORE_SYNC_MS
            node.clock_offset_ms = 0
            if node.is_up:
                self.loop.resume(node.owner)
            node.note_faults()
            node.start()
        self.wires.reconnect_all()
        height = max(node.handed_height for node in self.honest)
        indexes = tuple(node.index for node in self.honest)
        cores = [node.parts.core for node in self.honest if node.parts is not None]
        epoch, newest = max(((core.epoch, core.round) for core in cores), default=(0, 0))
        self.history.add(Healed(self.now, -1, height, epoch, newest, indexes))


@contextmanager
def quiet_logs() -> Iterator[list[str]]:
    """Silence the nodes' logs; yields the list of logged exceptions."""
    before, logged = structlog.get_config(), list[str]()

    def drop(_logger: Any, _method: str, event: Any) -> Any:
        error = event.get("exc_info")
        if error:
            shown = error if isinstance(error, BaseException) else sys.exc_info()[1]
            logged.append(f"logged {event.get('event')}: {shown!r}")
        raise structlog.DropEvent

    structlog.configure(processors=[drop])
    try:
        yield logged
    finally:
        structlog.configure(**before)

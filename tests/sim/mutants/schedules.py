"""The schedules under which mutants are caught: chance where chance is enough, and scripts where it is not.

All of them play the production node in the simulator, with the simulator's checkers. Must never know of any mutant.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from types import ModuleType
from typing import Any

import msgspec

from consensus.chain.messages import Proposal
from consensus.chain.transaction import Transaction, sign_transaction
from consensus.protocol.effects import Message
from contracts.execution.epochs import read_epoch
from network.byzantine import Behaviour
from network.sim.checkers import Violation
from network.sim.plan import FLOODS, Fault, Plan, make_custody_plan, make_flood_plan, make_plan
from network.sim.run import run_seed
from network.sim.workload import producer_turnover
from network.sim.world import sim_cluster as cluster_module
from network.sim.world.sim_chain import EPOCH_MS
from network.sim.world.sim_cluster import SimCluster
from network.sim.world.sim_node import SimNode
from node.consensus import journal_writer
from node.consensus.engine import Outbox
from node.retention import pruning
from node.snapshot.checking import restore_into
from node.snapshot.making import make_snapshot
from node.snapshot.snapshot_format import MemorySnapshotFolder
from node.storage.memory_store import MemoryRestore
from tests.sim.mutants.mutant import Schedule

ROUNDS = 60
LIAR = 1


def played(plan: Plan, *setups: Callable[[SimCluster], None]) -> list[Violation]:
    """Play a plan after these changes to the stage; return what the checkers find."""

    def mutate(cluster: SimCluster) -> None:
        for setup in setups:
            setup(cluster)

    return list(run_seed(plan, mutate=mutate).violations)


@contextmanager
def with_constants(module: ModuleType, **values: float) -> Iterator[None]:
    """Give constants of a module other values for a while."""
    before = {name: getattr(module, name) for name in values}
    vars(module).update(values)
    try:
        yield
    finally:
        vars(module).update(before)


# Chance


def play_chaos(seed: int) -> list[Violation]:
    """One to a dozen faults of all kinds, drawn from the seed."""
    return played(make_plan(seed, rounds=ROUNDS))


def play_halves(seed: int) -> list[Violation]:
    """The network falls into two halves, for longer than rounds take."""
    dice = random.Random(f"halves {seed}")
    order = dice.sample(range(4), 4)
    groups = (tuple(sorted(order[:2])), tuple(sorted(order[2:])))
    faults = (Fault(kind="partition", at_ms=300, for_ms=3_000, groups=groups),)
    return played(Plan(seed=seed, rounds=ROUNDS, faults=faults))


def play_power_cuts(seed: int) -> list[Violation]:
    """All nodes lose their power at once, and have it back a moment later, again and again."""
    dice = random.Random(f"power {seed}")
    cuts = [Fault(kind="power-cut", at_ms=250 + 250 * number + dice.randint(0, 150), for_ms=40) for number in range(8)]
    return played(Plan(seed=seed, rounds=ROUNDS, faults=tuple(cuts)))


def play_expired_flood(seed: int) -> list[Violation]:
    """A member floods the others with transactions that were over long ago, each under a signature of nobody's."""
    plan = make_flood_plan(seed, rounds=2 * ROUNDS, kinds=("expired-transactions",))
    flood = msgspec.structs.replace(plan.faults[0], amount=FLOODS["expired-transactions"][1])
    return played(msgspec.structs.replace(plan, faults=(flood,)))


EXPIRED_FLOOD = Schedule("flood of expired transactions", play_expired_flood, range(3))
CHAOS = Schedule("chaos", play_chaos, range(16))
HALVES = Schedule("halves", play_halves, range(3))
POWER_CUTS = Schedule("power cuts", play_power_cuts, range(8))


# Custodians that come and go


def play_custody(seed: int) -> list[Violation]:
    """Custodians join, leave and die, with erasures in flight, and nothing else goes wrong."""
    plan = msgspec.structs.replace(make_custody_plan(seed, rounds=ROUNDS), faults=())
    with with_constants(cluster_module, MORE_ROUNDS_MAX_S=12.0, SETTLE_MAX_S=10.0):
        return played(plan)


CUSTODY = Schedule("custody", play_custody, (0, 3))
"""Seeds that settle within ten seconds with all rules on; not all do."""


# Journals that are all there is


class Punctual(random.Random):
    """A store's dice: every commit takes as long as it may, and none is done before its time."""

    def uniform(self, a: float, b: float) -> float:
        return max(a, b)

    def random(self) -> float:
        return 0.999


def make_punctual(cluster: SimCluster) -> None:
    """Let all stores work in step."""
    for node in cluster.nodes:
        node.ledger._dice = Punctual()


def play_stores_behind(seed: int) -> list[Violation]:
    """All stores are slow, so that for a while only journals hold what is final; then all lose power.

    Journals are compacted whenever blocks are stored. Two commits are done before the cut, and the third is not.
    """
    slow = [Fault(kind="slow-store", at_ms=300, for_ms=2_000, node=node, amount=300) for node in range(4)]
    cut = Fault(kind="power-cut", at_ms=300 + 2 * 330 + 100, for_ms=40)
    with with_constants(journal_writer, COMPACT_ABOVE_BYTES=1):
        return played(Plan(seed=seed, rounds=ROUNDS, faults=(*slow, cut)), make_punctual)


STORES_BEHIND = Schedule("stores behind", play_stores_behind, range(4))


# Old files


def play_old_journal(seed: int) -> list[Violation]:
    """A partition stops the chain; a node that has given rounds up there comes back with an older journal."""
    dice = random.Random(f"old {seed}")
    at_ms = 700 + dice.randint(0, 100)
    age_ms = 500 + dice.randint(0, 700)
    faults = (
        Fault(kind="partition", at_ms=at_ms + 50, for_ms=age_ms + 100, groups=((0, 1), (2, 3))),
        Fault(kind="old-disk", at_ms=at_ms, for_ms=20, node=3, amount=age_ms, point="journal"),
        Fault(kind="links", at_ms=at_ms + age_ms, for_ms=800, profile="storm"),
    )
    return played(Plan(seed=seed, rounds=ROUNDS, faults=faults))


OLD_JOURNAL = Schedule("old journal", play_old_journal, range(30, 60))
"""Five of these seeds show the mutant, the first of them at once."""


# Liars


def lie_to_all(cluster: SimCluster) -> None:
    """Let the equivocating leader show both of its blocks to everybody."""
    node = cluster.nodes[LIAR]
    wrap = node._wrap_outbox

    def wrapped(inner: Outbox) -> Outbox:
        outbox = wrap(inner)
        if not isinstance(outbox, Behaviour):
            raise AssertionError("node is no liar")
        outbox.halves = lambda: (outbox.others(), outbox.others())  # type: ignore[method-assign]
        return outbox

    node._wrap_outbox = wrapped  # type: ignore[method-assign]


def play_two_blocks_for_all(seed: int) -> list[Violation]:
    """A leader shows two blocks of each of its rounds to everybody."""
    return played(Plan(seed=seed, rounds=ROUNDS, byzantine={str(LIAR): "equivocate"}), lie_to_all)


TWO_BLOCKS_FOR_ALL = Schedule("two blocks for all", play_two_blocks_for_all, range(2))


def replay(cluster: SimCluster) -> None:
    """Let the liar put the first transaction that it ever built into each of its later blocks again."""
    node = cluster.nodes[LIAR]
    old: list[Transaction] = []
    begin = node._wrap_outbox

    def wrapped(inner: Outbox) -> Outbox:
        executor = node.starting.executor
        choose = executor.choose

        def choose_again(mempool: Any, parent_id: bytes, timestamp_ms: int) -> list[Transaction]:
            chosen = choose(mempool, parent_id, timestamp_ms)
            is_stored = old and executor.reader.locate(old[0].txid) is not None
            if not old:
                old.extend(chosen[:1])
            return [*old, *chosen] if is_stored else chosen

        executor.choose = choose_again  # type: ignore[method-assign]
        return begin(inner)

    node._wrap_outbox = wrapped  # type: ignore[method-assign]


def prune_now_and_then(cluster: SimCluster) -> None:
    """Let all nodes but the custodians prune what is older than a few blocks: the final audit reads the custodians'."""

    def prune() -> None:
        for node in cluster.nodes:
            if node.is_serving and node.custody_key is None:
                cluster.run_on(node.owner, partial(_prune, node.ledger, node.ledger_height - 4))
        cluster._after(300, prune)

    cluster._after(300, prune)


async def _prune(ledger: Any, below_height: int) -> None:
    await pruning.prune_ledger(ledger, max(1, below_height))


def begin_again_from_snapshots(cluster: SimCluster) -> None:
    """Let each node but the custodians begin again from a snapshot of its own ledger, now and then."""

    def begin_again(node: SimNode) -> None:
        if node.is_serving and node.ledger_height > 0:
            folder, restore = MemorySnapshotFolder(), MemoryRestore()
            with node.ledger.snapshot() as ledger:
                make_snapshot(ledger, folder)
            restore_into(folder, cluster.chain.genesis, restore)
            if restore.store is None:
                raise AssertionError("the snapshot gave no ledger")
            node.crash("snapshot")
            node.ledger.restore(restore.store)
            cluster._after(10, node.start)

    for number, node in enumerate(node for node in cluster.nodes if node.custody_key is None):
        for again in range(4):
            cluster._after(400 + 300 * number + 1_000 * again, partial(begin_again, node))


def play_a_replay(seed: int) -> list[Violation]:
    """A leader brings a stored transaction again in each of its blocks, as long as it has not expired.

    Its peers would not hear a liar that they cut off: so this one is only silent at votes.
    """
    return played(Plan(seed=seed, rounds=ROUNDS, byzantine={str(LIAR): "withhold-votes"}), replay)


def play_a_replay_after_pruning(seed: int) -> list[Violation]:
    """The same, while others prune."""
    return played(Plan(seed=seed, rounds=ROUNDS, byzantine={str(LIAR): "withhold-votes"}), replay, prune_now_and_then)


def play_a_replay_after_snapshots(seed: int) -> list[Violation]:
    """The same, while others begin again from snapshots."""
    return played(
        Plan(seed=seed, rounds=ROUNDS, byzantine={str(LIAR): "withhold-votes"}), replay, begin_again_from_snapshots
    )


def play_wrong_roots(seed: int) -> list[Violation]:
    """A leader names wrong results in the headers of its blocks."""
    return played(Plan(seed=seed, rounds=ROUNDS, byzantine={str(LIAR): "wrong-roots"}))


WRONG_ROOTS = Schedule("wrong roots", play_wrong_roots, range(2))
REPLAY = Schedule("replay", play_a_replay, range(2))
REPLAY_AFTER_SNAPSHOTS = Schedule("replay after snapshots", play_a_replay_after_snapshots, range(1))
REPLAY_AFTER_PRUNING = Schedule("replay after pruning", play_a_replay_after_pruning, range(2))


# Epochs


def change_setting(cluster: SimCluster, number: int, heartbeat_ms: int) -> list[bytes]:
    """Return the transactions by which both organisations change a setting: the second is a boundary."""
    chain = cluster.chain
    make = partial(
        sign_transaction,
        chain_id=chain.genesis.chain_id,
        contract="settings",
        valid_until_ms=EPOCH_MS + 9 * 60_000,
        salt=number.to_bytes(8, "big"),
    )
    proposal = make(chain.admins[0], entry="propose", arguments=["heartbeat_ms", heartbeat_ms])
    approval = make(chain.admins[1], entry="approve", arguments=[proposal.txid])
    return [proposal.wire, approval.wire]


def change_settings(cluster: SimCluster, times_ms: tuple[int, ...]) -> None:
    """Change a setting at each of these times; ask again until it is done."""

    def ask(wires: list[bytes], place: int) -> None:
        for node in cluster.nodes:
            if node.is_serving and node.parts is not None:
                cluster.run_on(node.owner, partial(_submit, node.parts.pool, wires[place : place + 1]))

    for number, at_ms in enumerate(times_ms):
        wires = change_setting(cluster, number, 20_000 + number)
        for again in range(12):
            cluster._at(at_ms + 150 * again, partial(ask, wires, 0))
            cluster._at(at_ms + 150 * again + 75, partial(ask, wires, 1))


async def _submit(pool: Any, wires: list[bytes]) -> None:
    await pool.submit(wires)


def played_with_changes(
    plan: Plan, *times_ms: int, setups: tuple[Callable[[SimCluster], None], ...] = ()
) -> list[Violation]:
    """Play a plan with changes of a setting; look in the end whether they are in force.

    Nodes that cannot leave an epoch make closing blocks as fast as they can: so nobody waits long for them.
    """
    stage: list[SimCluster] = []
    with with_constants(cluster_module, HEALED_MAX_S=4.0, MORE_ROUNDS_MAX_S=4.0, SETTLE_MAX_S=4.0):
        violations = played(plan, stage.append, partial(change_settings, times_ms=times_ms), *setups)
    for node in stage[0].honest:
        with node.ledger.snapshot() as snapshot:
            decided = read_epoch(snapshot).number
            seated = read_epoch(snapshot).producers
        in_force = -1 if node.parts is None else node.parts.core.epoch
        if decided != in_force or decided == 0:
            text = f"{len(times_ms)} changes were asked for, epoch {decided} is decided and {in_force} in force"
            violations.append(Violation("epoch_in_force", 0.0, node.index, text))
        elif node.parts is not None and node.parts.engine.epoch.epoch.producers != seated:
            text = f"{len(seated)} producers are decided, and others in force"
            violations.append(Violation("epoch_in_force", 0.0, node.index, text))
    return violations


def play_changes(seed: int) -> list[Violation]:
    """Two changes of a setting, no faults: three epochs."""
    return played_with_changes(Plan(seed=seed, rounds=ROUNDS), 300, 900)


def remove_a_producer(cluster: SimCluster) -> None:
    """Let an organisation take the seat of its node, the last one, once all have stored some blocks."""
    removal = producer_turnover(cluster.plan.size, 0)[0][0].transaction.wire

    def ask() -> None:
        for node in cluster.nodes:
            if node.is_serving and node.parts is not None:
                cluster.run_on(node.owner, partial(_submit, node.parts.pool, [removal]))

    for again in range(12):
        cluster._at(300 + 150 * again, ask)


def play_a_removal(seed: int) -> list[Violation]:
    """One of four producers loses its seat; of the three that are left all are needed."""
    return played_with_changes(Plan(seed=seed, rounds=ROUNDS), setups=(remove_a_producer,))


def lose_the_next_leader(cluster: SimCluster) -> None:
    """Whenever a boundary is proposed, take the power of the leader of the next round for longer than a timeout."""
    seen: set[bytes] = set()

    def watch(node: SimNode) -> None:
        note = node.note_message

        def note_message(message: Message) -> None:
            note(message)
            if not isinstance(message, Proposal) or message.block.block_id in seen:
                return
            seen.add(message.block.block_id)
            if message.block.header.next_schedule_hash is not None:
                following = cluster.nodes[(message.block.header.round + 1) % len(cluster.nodes)]
                cluster._after(1, lambda: following.crash("next leader"))
                cluster._after(1_500, following.start)

        node.note_message = note_message  # type: ignore[method-assign]

    for node in cluster.nodes:
        watch(node)


def play_changes_and_lost_leaders(seed: int) -> list[Violation]:
    """A change of a setting, and the round after the boundary is lost: the certified pair comes later."""
    plan = Plan(seed=seed, rounds=ROUNDS)
    return played_with_changes(plan, 300, setups=(lose_the_next_leader,))


def cut_at_the_boundary(cluster: SimCluster) -> None:
    """Cut each node's power when its store has the boundary and its journal still is the old epoch's."""
    for node in cluster.nodes:
        durable = node.ledger._on_durable

        def on_durable(blocks: Any, node: Any = node, durable: Any = durable) -> None:
            durable(blocks)
            if any(block.epoch_proof_bytes for block in blocks):
                node.arm("before-sync", lambda: cluster._after(30, node.start))

        node.ledger._on_durable = on_durable


def play_a_cut_at_the_boundary(seed: int) -> list[Violation]:
    """All nodes lose power between storing a boundary and beginning the journal of the next epoch."""
    return played_with_changes(Plan(seed=seed, rounds=30), 500, setups=(cut_at_the_boundary,))


REMOVAL = Schedule("removal", play_a_removal, range(2))
CHANGES = Schedule("changes", play_changes, range(2))
CHANGES_AND_LOST_LEADERS = Schedule("changes and lost leaders", play_changes_and_lost_leaders, range(2))
CUT_AT_THE_BOUNDARY = Schedule("cut at the boundary", play_a_cut_at_the_boundary, range(2))

"""A simulated run's fault schedule: readable, writable, reducible, replayable.

`make_plan` draws one from a seed; `plan_file.py` prints it.
"""

from __future__ import annotations

import random
from typing import Any, Literal, NamedTuple

import msgspec

PLAN_MS_PER_ROUND = 22
OLD_DISK_SHARE = 0.15
GROWTH_SEATS_COUNT = (4, 7, 10)
CUSTODY_NODES_COUNT, CUSTODY_FOUNDING_COUNT = 7, 5
"""Custodians of the profile `custody`, and how many of them there are from the beginning."""
APART_EVERY_SEEDS = 8
SPARING_NODES_COUNT = 4
FLOODS: dict[str, tuple[int, int]] = {
    "expired-transactions": (256, 3_072),
    "forged-transactions": (256, 3_072),
    "ranges": (8, 64),
    "heights": (64, 256),
    "words": (64, 256),
}
"""What a member may flood the others with, and how many KiB a second of it seeds draw, for each peer."""
CRASH_POINTS = ("now", "before-sync", "torn-sync", "after-sync", "mid-broadcast", "mid-commit")
PROFILES: dict[str, dict[str, float]] = {
    "lan": {"delay_min_ms": 1, "delay_max_ms": 14},
    "wifi": {"delay_min_ms": 2, "delay_max_ms": 40, "loss": 0.01, "stragglers": 0.02},
    "wan": {"delay_min_ms": 20, "delay_max_ms": 90},
    "lossy": {"delay_min_ms": 2, "delay_max_ms": 60, "loss": 0.15, "duplicates": 0.1, "stragglers": 0.05},
    "storm": {"delay_min_ms": 1, "delay_max_ms": 600, "loss": 0.05, "duplicates": 0.2, "stragglers": 0.2},
}

_OF_EVERY_FAULT = frozenset({"kind", "at_ms", "for_ms"})

FaultKind = Literal[
    "crash",
    "power-cut",
    "partition",
    "one-way",
    "links",
    "pause",
    "skew",
    "slow-disk",
    "full-disk",
    "slow-store",
    "old-disk",
    "flood",
]


Governance = Literal["", "settings", "producers", "grow", "contracts", "custody"]


class Fault(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One fault: `at_ms` after start, for `for_ms`; other fields depend on the kind.

    crash: `node` dies at `point`. power-cut: all die. partition: `groups`. one-way: `peer` does not hear `node`. links:
    `profile`. pause, skew (`amount` ms), slow-disk (ms per sync), full-disk, slow-store (ms per commit): of `node`.
    old-disk: backup, death `amount` ms later, restore of `journal` or `machine` (`point`). flood: `amount` KiB/s of
    `point` to every peer.
    """

    kind: FaultKind
    at_ms: int
    for_ms: int
    node: int = -1
    peer: int = -1
    point: str = "now"
    groups: tuple[tuple[int, ...], ...] = ()
    profile: str = ""
    amount: int = 0

    def fields_set(self) -> dict[str, Any]:
        """Return the non-default fields, compared by value (robust to unpickling)."""
        usual = dict(zip(reversed(self.__struct_fields__), reversed(self.__struct_defaults__), strict=False))
        shown: dict[str, Any] = msgspec.to_builtins(self)
        return {name: value for name, value in shown.items() if name not in usual or getattr(self, name) != usual[name]}

    def __str__(self) -> str:
        rest = ", ".join(f"{name} {value}" for name, value in self.fields_set().items() if name not in _OF_EVERY_FAULT)
        return f"{self.at_ms} ms: {self.kind} for {self.for_ms} ms" + (f" ({rest})" if rest else "")


class NetworkSize(NamedTuple):
    """Number of nodes, and of initial producers (the first ones). `all_keep`: each is a custodian, else the first two."""

    nodes: int
    producers: int
    all_keep: bool = False


class Plan(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A run: seed, size and faults. `byzantine`: node index to behaviour.

    `rounds`: minimum; `profile`: default links; `producers`: initially seated (0: all), others follow without
    membership. `governance`: `settings`, `producers` (unseat, reseat), `grow` (followers join stepwise, leave),
    `contracts` (deploy, upgrade, disable, roll back), `custody` (custodians come, leave and die), or nothing.
    `executes_apart`: every node executes each block; else leader and first verifier only. `cpu`: work takes core time.
    """

    seed: int
    nodes: int = 4
    producers: int = 0
    rounds: int = 200
    profile: str = "lan"
    governance: Governance = ""
    executes_apart: bool = False
    cpu: bool = False
    byzantine: dict[str, str] = {}
    faults: tuple[Fault, ...] = ()

    @property
    def size(self) -> NetworkSize:
        return NetworkSize(self.nodes, self.producers or self.nodes, self.governance == "custody")

    @property
    def horizon_ms(self) -> int:
        return max([self.rounds * PLAN_MS_PER_ROUND, *(fault.at_ms + fault.for_ms for fault in self.faults)])

    @property
    def byzantine_nodes(self) -> dict[int, str]:
        return {int(index): behaviour for index, behaviour in self.byzantine.items()}


def max_faulty(nodes: int) -> int:
    return (nodes - 1) // 3


def make_plan(
    seed: int, *, nodes: int = 4, rounds: int = 200, byzantine: int = 0, behaviours: tuple[str, ...] = ()
) -> Plan:
    dice = random.Random(f"plan {seed} {nodes} {rounds} {byzantine}")  # noqa: S311 - a simulation's dice
    span_ms = rounds * PLAN_MS_PER_ROUND
    kinds: list[FaultKind] = dice.choices(
        [
            "crash",
            "power-cut",
            "partition",
            "one-way",
            "links",
            "pause",
            "skew",
            "slow-disk",
            "full-disk",
            "slow-store",
        ],
        weights=[30, 6, 14, 8, 14, 6, 4, 6, 4, 8],
        k=dice.randint(1, 12),
    )
    if byzantine < max_faulty(nodes) and dice.random() < OLD_DISK_SHARE:
        kinds.append("old-disk")  # of more than f forgetful or dishonest nodes nobody could say what was signed
    faults = [_draw(dice, kind, nodes, span_ms) for kind in kinds]
    chosen = dice.sample(range(nodes), byzantine) if behaviours else []
    return Plan(
        seed=seed,
        nodes=nodes,
        rounds=rounds,
        profile=dice.choice(("lan", "lan", "lan", "wifi")),
        governance=_draw_governance(dice, nodes, is_whole=not chosen and "old-disk" not in kinds),
        executes_apart=seed % APART_EVERY_SEEDS == 0,
        byzantine={str(index): dice.choice(behaviours) for index in sorted(chosen)},
        faults=tuple(sorted(faults, key=lambda fault: (fault.at_ms, str(fault)))),
    )


def make_growth_plan(seed: int, *, rounds: int = 200) -> Plan:
    """Draw plan `grow`: four producers; six followers seated in two steps, then unseated."""
    smallest, largest = GROWTH_SEATS_COUNT[0], GROWTH_SEATS_COUNT[-1]
    drawn = make_plan(seed, nodes=largest, rounds=rounds)
    faults = tuple(fault for fault in drawn.faults if fault.kind != "old-disk")
    return msgspec.structs.replace(drawn, producers=smallest, governance="grow", faults=faults)


def make_custody_plan(seed: int, *, rounds: int = 200) -> Plan:
    """Draw plan `custody`: four producers and three others, all of them custodians, of which some come, leave and die."""
    drawn = make_plan(seed, nodes=CUSTODY_NODES_COUNT, rounds=rounds)
    faults = tuple(fault for fault in drawn.faults if fault.kind != "old-disk")
    return msgspec.structs.replace(
        drawn, rounds=rounds, producers=SPARING_NODES_COUNT, governance="custody", faults=faults
    )


def make_flood_plan(seed: int, *, nodes: int = 4, rounds: int = 200, kinds: tuple[str, ...] = tuple(FLOODS)) -> Plan:
    dice = random.Random(f"floods {seed} {nodes} {rounds}")  # noqa: S311 - a simulation's dice
    span_ms = rounds * PLAN_MS_PER_ROUND
    faults = []
    for node in sorted(dice.sample(range(nodes), max_faulty(nodes))):
        kind = dice.choice(kinds)
        at_ms = round(span_ms * dice.uniform(0.4, 0.5))
        for_ms = round(span_ms * dice.uniform(0.3, 0.4))
        amount = dice.randint(*FLOODS[kind])
        faults.append(Fault(kind="flood", at_ms=at_ms, for_ms=for_ms, node=node, point=kind, amount=amount))
    return Plan(seed=seed, nodes=nodes, rounds=rounds, cpu=True, faults=tuple(faults))


def _draw_governance(dice: random.Random, nodes: int, *, is_whole: bool) -> Governance:
    """Draw the changes; only a seat that a fault-free network can spare."""
    drawn: Governance = dice.choices(("", "settings", "producers"), weights=[70, 15, 15])[0]
    return "" if nodes < SPARING_NODES_COUNT or (drawn == "producers" and not is_whole) else drawn


def _draw(dice: random.Random, kind: FaultKind, nodes: int, span_ms: int) -> Fault:
    at_ms = dice.randint(0, max(1, span_ms * 8 // 10))
    for_ms = round(span_ms * dice.uniform(0.01, 0.3))
    node = dice.randrange(nodes)
    fields: dict[str, Any] = {}
    match kind:
        case "crash":
            fields = {"node": node, "point": dice.choice(CRASH_POINTS)}
            for_ms = min(for_ms, dice.choice((20, 100, 400, 2_000)))
        case "power-cut":
            for_ms = min(for_ms, dice.choice((20, 200, 1_000)))
        case "partition":
            order = dice.sample(range(nodes), nodes)
            cut = dice.randint(1, nodes - 1) if nodes > 1 else 1
            fields = {"groups": tuple(tuple(sorted(part)) for part in (order[:cut], order[cut:]) if part)}
        case "one-way":
            fields = {"node": node, "peer": (node + dice.randint(1, max(1, nodes - 1))) % nodes}
        case "links":
            fields = {"profile": dice.choice(("wifi", "wan", "lossy", "storm"))}
        case "skew":
            fields = {"node": node, "amount": dice.choice((-3_600_000, -1_500, -200, 200, 1_500, 3_600_000))}
        case "slow-disk":
            fields = {"node": node, "amount": dice.choice((2, 10, 80))}
        case "slow-store":
            fields = {"node": node, "amount": dice.choice((50, 300, 1_500))}
        case "old-disk":
            age_ms = dice.choice((20, 200, 1_000))
            fields = {"node": node, "amount": age_ms, "point": dice.choice(("journal", "machine"))}
        case _:
            fields = {"node": node}
    return Fault(kind=kind, at_ms=at_ms, for_ms=max(1, for_ms), **fields)

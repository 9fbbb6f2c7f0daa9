"""Plans as TOML files, and validation of hand-written plans."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import msgspec

from clients.sdk.new_files import read_given_file
from consensus.bounded_text import TOML_MAX_BYTES, read_toml_text
from consensus.errors import BlockRobotError
from network.byzantine import BEHAVIOURS
from network.sim.plan import (
    CRASH_POINTS,
    CUSTODY_NODES_COUNT,
    FLOODS,
    PROFILES,
    SPARING_NODES_COUNT,
    Fault,
    Plan,
)

FAULTS_MAX_COUNT = 200
NODES_MAX_COUNT = 10
ROUNDS_MIN_COUNT, ROUNDS_MAX_COUNT = 10, 5_000
SEED_MAX = 1 << 32
ENDS_MAX_MS = 600_000
AMOUNT_MAX_MS = 86_400_000
FLOOD_MAX_KIB_PER_S = 20_480
OLD_DISK_POINTS = ("journal", "machine")
_OF_A_NODE = frozenset(
    {"crash", "one-way", "pause", "skew", "slow-disk", "full-disk", "slow-store", "old-disk", "flood"}
)


def plan_to_toml(plan: Plan) -> str:
    lines = [f"seed = {plan.seed}", f"nodes = {plan.nodes}", f"rounds = {plan.rounds}", f'profile = "{plan.profile}"']
    if plan.producers:
        lines.append(f"producers = {plan.producers}")
    if plan.governance:
        lines.append(f'governance = "{plan.governance}"')
    if plan.executes_apart:
        lines.append("executes_apart = true")
    if plan.cpu:
        lines.append("cpu = true")
    if plan.byzantine:
        lines += ["", "[byzantine]", *(f'{index} = "{behaviour}"' for index, behaviour in plan.byzantine.items())]
    for fault in plan.faults:
        lines += ["", "[[faults]]"]
        for name, value in fault.fields_set().items():
            shown = (
                f'"{value}"'
                if isinstance(value, str)
                else str([list(part) for part in value] if name == "groups" else value)
            )
            lines.append(f"{name} = {shown}")
    return "\n".join(lines) + "\n"


def load_plan(path: Path) -> Plan:
    """Raises CONFIGURATION_INVALID, FILE_UNUSABLE."""
    try:
        data = read_given_file(path, TOML_MAX_BYTES)
    except OSError as error:
        raise BlockRobotError("FILE_UNUSABLE", f"{path}: {error.strerror}.") from None
    try:
        plan = msgspec.convert(read_toml_text(data), Plan)
    except (ValueError, msgspec.ValidationError) as error:
        raise BlockRobotError("CONFIGURATION_INVALID", f"The plan {path} cannot be read: {error}.") from None
    wrong = find_problem(plan)
    if wrong:
        raise BlockRobotError("CONFIGURATION_INVALID", f"The plan {path}: {wrong}.")
    return plan


def find_problem(plan: Plan) -> str:
    """The first that makes a plan unplayable, or ""."""
    return next(_problems_of_plan(plan), "")


def _problems_of_plan(plan: Plan) -> Iterator[str]:
    if not 0 <= plan.seed < SEED_MAX:
        yield f"the seed lies between 0 and {SEED_MAX - 1}"
    if not 1 <= plan.nodes <= NODES_MAX_COUNT or not 0 <= plan.producers <= plan.nodes:
        yield f"there are 1 to {NODES_MAX_COUNT} nodes, and no more producers than nodes"
    if not ROUNDS_MIN_COUNT <= plan.rounds <= ROUNDS_MAX_COUNT:
        yield f"a run has {ROUNDS_MIN_COUNT} to {ROUNDS_MAX_COUNT} rounds"
    if plan.governance == "custody" and (plan.nodes, plan.producers) != (CUSTODY_NODES_COUNT, SPARING_NODES_COUNT):
        yield f"custodians come and go among {CUSTODY_NODES_COUNT} nodes, {SPARING_NODES_COUNT} of them producers"
    if plan.profile not in PROFILES:
        yield f"there is no profile {plan.profile!r}; there are {', '.join(PROFILES)}"
    for index, behaviour in plan.byzantine.items():
        if not index.isdecimal() or not 0 <= int(index) < plan.nodes:
            yield f"there is no node {index}: nodes count from 0 to {plan.nodes - 1}"
        if behaviour not in BEHAVIOURS:
            yield f"there is no behaviour {behaviour!r}; there are {', '.join(sorted(BEHAVIOURS))}"
    if len(plan.faults) > FAULTS_MAX_COUNT:
        yield f"a plan has at most {FAULTS_MAX_COUNT} faults"
    if any(fault.kind == "flood" for fault in plan.faults) and not plan.cpu:
        yield "a flood harms nobody whose work takes no time: say cpu = true"
    for number, fault in enumerate(plan.faults, 1):
        for problem in _problems_of_fault(fault, plan.nodes):
            yield f"fault {number} ({fault.kind}): {problem}"


def _problems_of_fault(fault: Fault, nodes: int) -> Iterator[str]:
    if fault.at_ms < 0 or fault.for_ms < 1 or fault.at_ms + fault.for_ms > ENDS_MAX_MS:
        yield f"it begins at 0 ms or later, lasts 1 ms or longer, and is over at {ENDS_MAX_MS} ms"
    least = -AMOUNT_MAX_MS if fault.kind == "skew" else 0
    if not least <= fault.amount <= AMOUNT_MAX_MS:
        yield f"the amount lies between {least} and {AMOUNT_MAX_MS} ms"
    if fault.kind == "flood" and not 1 <= fault.amount <= FLOOD_MAX_KIB_PER_S:
        yield f"a flood has 1 to {FLOOD_MAX_KIB_PER_S} KiB a second"
    if fault.kind in _OF_A_NODE and not 0 <= fault.node < nodes:
        yield f"it is of a node, 0 to {nodes - 1}"
    match fault.kind:
        case "one-way" | "partition" if nodes == 1:
            return  # a lone node has no links; seeds draw such faults nevertheless
        case "one-way" if not 0 <= fault.peer < nodes or fault.peer == fault.node:
            yield f"its peer is another node, 0 to {nodes - 1}"
        case "crash" if fault.point not in CRASH_POINTS:
            yield f"there is no point {fault.point!r}; there are {', '.join(CRASH_POINTS)}"
        case "flood" if fault.point not in FLOODS:
            yield f"there is no flood {fault.point!r}; there are {', '.join(FLOODS)}"
        case "old-disk" if fault.point not in OLD_DISK_POINTS:
            yield f"what is put back is the {' or the '.join(OLD_DISK_POINTS)} (point)"
        case "links" if fault.profile not in PROFILES:
            yield f"there is no profile {fault.profile!r}; there are {', '.join(PROFILES)}"
        case "partition":
            yield from _problems_of_groups(fault, nodes)


def _problems_of_groups(fault: Fault, nodes: int) -> Iterator[str]:
    members = [index for group in fault.groups for index in group]
    if len(fault.groups) < 2 or not all(fault.groups) or len(set(members)) != len(members):
        yield "it has two groups or more, none of them empty, and no node is in two"
    if not all(0 <= index < nodes for index in members):
        yield f"its groups name nodes, 0 to {nodes - 1}"

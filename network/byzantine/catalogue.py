"""All behaviours by name, and their construction."""

from __future__ import annotations

from collections.abc import Callable
from random import Random

from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from network.byzantine.behaviour import Behaviour, ByzantineContext, ColludingNodes, OwnNode
from network.byzantine.certificates import ForgedCertificates, StaleCertificates
from network.byzantine.epochs import WrongEpochs
from network.byzantine.garbage import Garbage
from network.byzantine.proposals import Equivocate, PartialProposals, TimeLimit, WithholdBlocks, WrongRoots
from network.byzantine.votes import DoubleVote, WithholdVotes
from node.consensus.engine import Outbox

_CLASSES: tuple[type[Behaviour], ...] = (
    Equivocate,
    DoubleVote,
    WithholdVotes,
    WithholdBlocks,
    PartialProposals,
    StaleCertificates,
    ForgedCertificates,
    WrongEpochs,
    WrongRoots,
    TimeLimit,
    Garbage,
)
BEHAVIOURS: dict[str, type[Behaviour]] = {behaviour.name: behaviour for behaviour in _CLASSES}


def check_behaviour(name: str) -> tuple[type[Behaviour], ...]:
    """Of names joined with `+`. Raises FAULT_UNKNOWN."""
    parts = name.split("+")
    unknown = [part for part in parts if part not in BEHAVIOURS]
    if unknown or len(set(parts)) != len(parts):
        raise BlockRobotError("FAULT_UNKNOWN", f"There is no behaviour {name!r}; there are {', '.join(BEHAVIOURS)}.")
    return tuple(BEHAVIOURS[part] for part in parts)


def make_behaviour(
    name: str,
    *,
    inner: Outbox,
    own: OwnNode,
    key: PrivateKey,
    chance: Random,
    accomplices: ColludingNodes | None = None,
) -> Behaviour:
    """Wrap an outbox; with `+` the first acts first. Raises FAULT_UNKNOWN."""
    liar = ByzantineContext(own, key, chance, ColludingNodes() if accomplices is None else accomplices)
    *rest, last = check_behaviour(name)
    outbox = last(inner, liar)
    for behaviour in reversed(rest):
        outbox = behaviour(outbox, liar)
    return outbox


def byzantine_clock(name: str, clock_ms: Callable[[], int], max_clock_drift_ms: int) -> Callable[[], int]:
    """The given one or the maximum drift ahead."""
    if not any(behaviour.bends_clock for behaviour in check_behaviour(name)):
        return clock_ms
    return lambda: clock_ms() + max_clock_drift_ms

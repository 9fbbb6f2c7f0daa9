"""What the console answers its page and writes into an exported run, beside snapshots and events."""

from __future__ import annotations

from msgspec import UNSET, Struct, UnsetType

from network.console.rounds import RoundRow
from network.console.snapshots import ConsoleSnapshot
from network.console.timeline import Event


class NodeFacts(Struct, frozen=True):
    """Who a node is."""

    name: str
    organisation: str
    producer: bool
    custodian: bool
    breakable: bool


class NetworkFacts(Struct, frozen=True):
    """Who is in a network."""

    name: str
    quorum: int
    nodes: list[NodeFacts]


class KnownNetwork(Struct, frozen=True):
    """Who was in it from a time on."""

    at_ms: int
    network: NetworkFacts


class Choice(Struct, frozen=True):
    """Something to choose, and what it means."""

    name: str
    meaning: str


class Choices(Struct, frozen=True):
    """What faults there are to choose from."""

    behaviours: list[Choice]
    profiles: list[Choice]
    disks: list[str]
    folder: str


class Dropped(Struct, frozen=True):
    """How much was dropped, and a sentence of it; empty if nothing was."""

    moments: int
    events: int
    rounds: int
    words: str


class Recording(Struct, frozen=True):
    """What was recorded."""

    since_ms: int
    names: list[str]
    moments: int
    size_bytes: int
    dropped: Dropped


class StepError(Struct, frozen=True):
    """Why a step was refused."""

    code: str
    detail: str


class StepStatus(Struct):
    """A step of a plan, and what became of it."""

    at_ms: int
    line: int
    do: str
    done_at_ms: int | UnsetType = UNSET
    error: StepError | UnsetType = UNSET


class PlanStatus(Struct):
    """A plan; with its state if it was started."""

    seed: int
    steps: list[StepStatus]
    state: str | UnsetType = UNSET


class Now(Struct, frozen=True):
    """The newest moment, its nodes, last rounds and events."""

    sequence: int
    network: NetworkFacts
    moment: ConsoleSnapshot | None
    rounds: list[RoundRow]
    events: list[Event]
    plan: PlanStatus | None
    recording: Recording


class Past(Struct, frozen=True):
    """What was at a time."""

    moment: ConsoleSnapshot | None
    network: NetworkFacts | None
    rounds: list[RoundRow]

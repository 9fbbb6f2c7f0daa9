"""A simulation's history: typed observations in order, and a running hash.

Checkers judge only these.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Callable
from typing import TypeVar

import msgspec

LOST = "lost"
"""Why a node stopped that is gone with its disk."""
_FRAME = struct.Struct(">dBBB")


class Observation(msgspec.Struct, frozen=True, array_like=True, tag=True):
    """An observation at a virtual time (ms since start), mostly with node index."""

    at_ms: float
    node: int


class NodeStarted(Observation, frozen=True):
    """A node started with this ledger head and custody checkpoint (-1: none)."""

    height: int
    block_id: bytes
    state_root: bytes
    custody_height: int


class NodeRefusedStart(Observation, frozen=True):
    """A node refused to start, with this error code."""

    code: str


class NodeRestored(Observation, frozen=True):
    """A backup was restored on a stopped node; its ledger ends here."""

    height: int


class NodeStopped(Observation, frozen=True):
    """A node lost power or was stopped."""

    why: str


class VoteSent(Observation, frozen=True):
    """A vote left a node."""

    epoch: int
    round: int
    block_id: bytes


class TimeoutSent(Observation, frozen=True):
    """A timeout left a node."""

    epoch: int
    round: int
    high_qc_round: int


class ProposalSent(Observation, frozen=True):
    """A node sent its own proposal."""

    epoch: int
    round: int
    height: int
    block_id: bytes


class BlockFinalized(Observation, frozen=True):
    """A core finalized a block (`stored` False), or its store made it durable (True)."""

    stored: bool
    height: int
    epoch: int
    round: int
    block_id: bytes
    state_root: bytes
    txids: tuple[bytes, ...]


class EpochBegan(Observation, frozen=True):
    """A node entered an epoch: number, producers' keys, first block."""

    epoch: int
    producers: tuple[bytes, ...]
    boundary: bytes


class Asked(Observation, frozen=True):
    """A client sends a transaction to a node, which may never receive it."""

    txid: bytes


class Submitted(Observation, frozen=True):
    """A client submitted a transaction; `code` is empty if accepted."""

    txid: bytes
    code: str


class Acknowledged(Observation, frozen=True):
    """A node reported a transaction final, with place and outcome.

    `excused`: the only codes with which the call may fail.
    """

    txid: bytes
    height: int
    block_id: bytes
    ok: bool
    code: str = "OK"
    excused: tuple[str, ...] = ()


class ClipTaken(Observation, frozen=True):
    """A custodian confirmed a clip to a robot."""

    record_id: bytes


class ValueRead(Observation, frozen=True):
    """A client's read of finalized state: height, root, value digest."""

    key: bytes
    height: int
    state_root: bytes
    digest: bytes


class CustodyAudit(Observation, frozen=True):
    """A custodian's store at its checkpoint and its chain's content there, sorted.

    `confirmed`, `missing`, `elsewhere` (others are to keep it), `erased`: record ids; `keys_left`: keys that still open
    erased frames.
    """

    checkpoint: int
    checkpoint_id: bytes
    confirmed: tuple[bytes, ...]
    missing: tuple[bytes, ...]
    elsewhere: tuple[bytes, ...]
    erased: tuple[bytes, ...]
    granted: tuple[bytes, ...]
    chain_id_at: bytes
    chain_recorded: tuple[bytes, ...]
    chain_erased: tuple[bytes, ...]
    chain_granted: tuple[bytes, ...]
    keys_left: int


class ClipKept(Observation, frozen=True):
    """A custodian's store took a clip, from a robot or from another custodian."""

    record_id: bytes


class ChainAudit(Observation, frozen=True):
    """The chain at the end: custodians (node indexes), how many keep a clip, active records with their keepers, erasures
    with their records and who has confirmed.
    """

    members: tuple[int, ...]
    copies: int
    keepers: tuple[tuple[bytes, tuple[int, ...]], ...]
    erasures: tuple[tuple[bytes, tuple[bytes, ...], tuple[int, ...]], ...]


class FaultBegan(Observation, frozen=True):
    """A fault of the plan took effect."""

    text: str


class Flooded(Observation, frozen=True):
    """A node starts flooding until `until_ms`, in a network without other faults."""

    until_ms: float
    text: str


class PeerCutOff(Observation, frozen=True):
    """A node temporarily cut off a misbehaving peer."""

    peer: int
    code: str


class Healed(Observation, frozen=True):
    """All faults are over; highest honest `height`, and `round` of the newest `epoch`."""

    height: int
    epoch: int
    round: int
    honest: tuple[int, ...]


class Ended(Observation, frozen=True):
    """The run ended; each node's stored height and round (-1: down).

    `settled`: all answered, stored and kept everywhere. `reached`: the requested rounds were played.
    """

    heights: tuple[int, ...]
    rounds: tuple[int, ...]
    settled: bool
    reached: bool = True


class ExecutionDiffered(Observation, frozen=True):
    """Two executions of a block at this height differed."""

    height: int
    text: str


class CodeFault(Observation, frozen=True):
    """An uncaught exception."""

    text: str


Kind = TypeVar("Kind", bound=Observation)


class History:
    """One run's observations; `listener`, if set, receives each."""

    def __init__(self, listener: Callable[[Observation], None] | None = None) -> None:
        self.observations: list[Observation] = []
        self.listener = listener
        self.byzantine: frozenset[int] = frozenset()
        self._hash = hashlib.blake2b(digest_size=16)

    def add(self, observation: Observation) -> None:
        self.observations.append(observation)
        self._hash.update(msgspec.msgpack.encode(observation))
        if self.listener is not None:
            self.listener(observation)

    def note_frame(self, at_ms: float, sender: int, receiver: int, kind: int, payload: bytes) -> None:
        self._hash.update(_FRAME.pack(at_ms, sender, receiver, kind))
        self._hash.update(payload)

    def of(self, kind: type[Kind]) -> list[Kind]:
        return [item for item in self.observations if type(item) is kind]

    @property
    def lost(self) -> frozenset[int]:
        """Nodes that never came back."""
        return frozenset(item.node for item in self.of(NodeStopped) if item.why == LOST)

    @property
    def trace_hash(self) -> str:
        return self._hash.hexdigest()


class Violation(msgspec.Struct, frozen=True):
    """A violation: checker, time (ms), node (-1: whole network), detail."""

    checker: str
    at_ms: float
    node: int
    text: str

    def __str__(self) -> str:
        where = "" if self.node < 0 else f" at node {self.node}"
        return f"{self.checker}{where}, {self.at_ms:.1f} ms: {self.text}"

"""What happened in a simulated network, as typed observations in order, and a running hash over all of it.

Checkers judge nothing but these.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Callable
from typing import TypeVar

import msgspec

_FRAME = struct.Struct(">dBBB")


class Observation(msgspec.Struct, frozen=True, array_like=True, tag=True):
    """Something seen at a virtual time (ms since the start), mostly at a node (its index)."""

    at_ms: float
    node: int


class NodeStarted(Observation, frozen=True):
    """A node came up with this ledger head and this checkpoint of its custodian's store (-1: none)."""

    height: int
    block_id: bytes
    state_root: bytes
    custody_height: int


class NodeRefusedStart(Observation, frozen=True):
    """A node would not start, with this error code."""

    code: str


class NodeRestored(Observation, frozen=True):
    """A backup was put back on a node that is down: its ledger now ends at this height."""

    height: int


class NodeStopped(Observation, frozen=True):
    """A node lost its power, or was stopped."""

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
    """A proposal of a node's own left it."""

    epoch: int
    round: int
    height: int
    block_id: bytes


class BlockFinalized(Observation, frozen=True):
    """A node's core called a block final and handed it to the store (`stored` False), or its store has it safe (True)."""

    stored: bool
    height: int
    epoch: int
    round: int
    block_id: bytes
    state_root: bytes
    txids: tuple[bytes, ...]


class EpochBegan(Observation, frozen=True):
    """A node is in an epoch from now on: its number, its producers' keys, and the block from which it begins."""

    epoch: int
    producers: tuple[bytes, ...]
    boundary: bytes


class Asked(Observation, frozen=True):
    """A client sends a transaction to a node; it may be busy, or never get it."""

    txid: bytes


class Submitted(Observation, frozen=True):
    """A client handed a transaction to a node; `code` is empty if the node took it."""

    txid: bytes
    code: str


class Acknowledged(Observation, frozen=True):
    """A node told a client that a transaction is final, in this place, and what came of it.

    `excused` are the codes with which such a call may fail, whatever nodes do: nothing else may come of it but success.
    """

    txid: bytes
    height: int
    block_id: bytes
    ok: bool
    code: str = "OK"
    excused: tuple[str, ...] = ()


class ClipTaken(Observation, frozen=True):
    """A custodian told a robot that it has a clip."""

    record_id: bytes


class ValueRead(Observation, frozen=True):
    """A client read a key of the finalized state: the state's height and root, and a digest of the value."""

    key: bytes
    height: int
    state_root: bytes
    digest: bytes


class CustodyAudit(Observation, frozen=True):
    """What a custodian's store holds at its checkpoint, beside what the node's chain says up to there, each sorted.

    `confirmed`, `missing`, `erased` are record ids; `keys_left` counts keys that still open an erased frame.
    """

    checkpoint: int
    checkpoint_id: bytes
    confirmed: tuple[bytes, ...]
    missing: tuple[bytes, ...]
    erased: tuple[bytes, ...]
    granted: tuple[bytes, ...]
    chain_id_at: bytes
    chain_recorded: tuple[bytes, ...]
    chain_erased: tuple[bytes, ...]
    chain_granted: tuple[bytes, ...]
    keys_left: int


class FaultBegan(Observation, frozen=True):
    """An entry of the fault plan took effect."""

    text: str


class Flooded(Observation, frozen=True):
    """A node begins to send the others more than anybody should, until `until_ms`, in a network without other faults."""

    until_ms: float
    text: str


class PeerCutOff(Observation, frozen=True):
    """A node does not hear a peer for a while, since that sent what no honest node sends."""

    peer: int
    code: str


class Healed(Observation, frozen=True):
    """All faults are over; `height` is the highest of any honest node, `round` the highest of the newest `epoch`."""

    height: int
    epoch: int
    round: int
    honest: tuple[int, ...]


class Ended(Observation, frozen=True):
    """The run is over; each node's stored height and round (-1: down).

    `settled`: all is answered, stored and kept everywhere. `reached`: so many rounds were played as were asked for.
    """

    heights: tuple[int, ...]
    rounds: tuple[int, ...]
    settled: bool
    reached: bool = True


class ExecutionDiffered(Observation, frozen=True):
    """Two executions of one block of this height gave different results."""

    height: int
    text: str


class CodeFault(Observation, frozen=True):
    """An exception that no code caught."""

    text: str


Kind = TypeVar("Kind", bound=Observation)


class History:
    """The observations of one run. `listener`, if set, is told of each as it comes."""

    def __init__(self, listener: Callable[[Observation], None] | None = None) -> None:
        self.observations: list[Observation] = []
        self.listener = listener
        self.byzantine: frozenset[int] = frozenset()
        self._hash = hashlib.blake2b(digest_size=16)

    def add(self, observation: Observation) -> None:
        """Note an observation."""
        self.observations.append(observation)
        self._hash.update(msgspec.msgpack.encode(observation))
        if self.listener is not None:
            self.listener(observation)

    def note_frame(self, at_ms: float, sender: int, receiver: int, kind: int, payload: bytes) -> None:
        """Take the arrival of a frame into the hash."""
        self._hash.update(_FRAME.pack(at_ms, sender, receiver, kind))
        self._hash.update(payload)

    def of(self, kind: type[Kind]) -> list[Kind]:
        """Return the observations of one type, in order."""
        return [item for item in self.observations if type(item) is kind]

    @property
    def trace_hash(self) -> str:
        """The hash over everything so far, in hex: equal for equal histories."""
        return self._hash.hexdigest()

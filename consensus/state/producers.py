"""State of the contract `producers`: epoch, settings, candidates and accusations."""

from __future__ import annotations

from typing import Any, Literal

from consensus.state.keys import KEY_BYTES, U32_BYTES, U64_BYTES, Prefix, Reader, Row, StateKey

PRODUCERS = "producers"


class EpochRow(Row, frozen=True):
    """The epoch following from the state: `leaderless` are producer indexes, `settings` by name."""

    number: int
    producers: list[bytes]
    leaderless: list[int]
    settings: dict[str, int | str]
    height: int


class CandidateRow(Row, frozen=True):
    """A candidate or producer; `evidence` is empty unless accused, `successor` unless its key was replaced."""

    name: str
    organisation: str
    votes: list[str]
    removals: list[str]
    status: Literal["candidate", "producing", "suspended", "removed"]
    since_ms: int
    ready_height: int
    ready_ms: int
    ready_root: bytes
    suspended_height: int
    reinstated_epoch: int
    evidence: dict[str, Any]
    successor: bytes


EPOCH: StateKey[EpochRow] = StateKey(PRODUCERS, "epoch", EpochRow)
CANDIDATE: Prefix[CandidateRow] = Prefix(PRODUCERS, "candidate/", (KEY_BYTES,), CandidateRow)
KEYS: StateKey[list[bytes]] = StateKey(PRODUCERS, "keys", list[bytes])
"""The candidates that were not removed."""
MAX_PRODUCERS: StateKey[int] = StateKey(PRODUCERS, "max_producers", int)
"""How many seats there are at most."""
ACCUSED: Prefix[bool] = Prefix(PRODUCERS, "accused/", (KEY_BYTES, U32_BYTES, U64_BYTES), bool)
"""By producer, epoch and round."""
LAYOUT = (EPOCH, CANDIDATE, KEYS, MAX_PRODUCERS, ACCUSED)


def is_candidate(state: Reader, key: bytes) -> bool:
    row = CANDIDATE.at(state, key)
    return row is not None and row.status != "removed"

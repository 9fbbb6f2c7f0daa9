"""Journal records that keep a restarted producer consistent; merged, every field only moves forward."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from consensus.chain.block import Block, QuorumCertificate, TimeoutCertificate
from consensus.chain.messages import Timeout, Vote
from consensus.primitives.encoding import Wire, decode, encode

KIND_PROPOSAL = "proposal"
KIND_VOTE = "vote"
KIND_TIMEOUT = "timeout"
KIND_BLOCK = "block"
KIND_STATE = "state"
KIND_LOCKOUT = "lockout"

LOCKOUT_RESTORED = "restored"
LOCKOUT_OUTDATED = "outdated"


class SigningLockout(Wire, frozen=True):
    """Signing lockout until a block above `above_round` of `epoch` is final (None: unknown)."""

    reason: str
    epoch: int
    above_round: int | None


class JournalRecord(Wire, frozen=True):
    """One entry; `blocks` are newly journalled, oldest first, `proposed_id` one's own."""

    kind: str
    epoch: int
    last_voted_round: int
    blocks: tuple[Block, ...]
    high_qc: QuorumCertificate | None
    entered_by: TimeoutCertificate | None
    proposed_id: bytes | None
    vote: Vote | None
    timeout: Timeout | None
    lockout: SigningLockout | None


@dataclass(slots=True)
class JournalState:
    """The merged journal: the newest of everything, by round."""

    last_voted_round: int = 0
    high_qc: QuorumCertificate | None = None
    entered_by: TimeoutCertificate | None = None
    vote: Vote | None = None
    timeout: Timeout | None = None
    proposed_id: bytes | None = None
    lockout: SigningLockout | None = None
    blocks: dict[bytes, Block] = field(default_factory=dict)
    later: list[bytes] = field(default_factory=list)
    """The records of later epochs, as they stand: the store is behind what this producer has said (R37)."""
    newest_epoch: int = 0


def encode_block_record(epoch: int, block: Block) -> bytes:
    record = JournalRecord(
        kind=KIND_BLOCK,
        epoch=epoch,
        last_voted_round=0,
        blocks=(block,),
        high_qc=None,
        entered_by=None,
        proposed_id=None,
        vote=None,
        timeout=None,
        lockout=None,
    )
    return encode(record)


def encode_lockout_record(epoch: int, last_voted_round: int, lockout: SigningLockout | None) -> bytes:
    record = JournalRecord(
        kind=KIND_LOCKOUT,
        epoch=epoch,
        last_voted_round=last_voted_round,
        blocks=(),
        high_qc=None,
        entered_by=None,
        proposed_id=None,
        vote=None,
        timeout=None,
        lockout=lockout,
    )
    return encode(record)


def encode_restored_record() -> bytes:
    return encode_lockout_record(0, 0, SigningLockout(reason=LOCKOUT_RESTORED, epoch=0, above_round=None))


def read_journal(records: Iterable[bytes], epoch: int) -> JournalState:
    """Merge the records of `epoch` in order. Raises ENCODING_*.

    Lockouts span epochs; earlier epochs' records limit nothing (R24), later ones are passed on.
    """
    state = JournalState(newest_epoch=epoch)
    for data in records:
        record = decode(data, JournalRecord)
        if record.kind in (KIND_LOCKOUT, KIND_STATE):
            state.lockout = record.lockout
        if record.epoch > epoch:
            state.later.append(data)
            state.newest_epoch = max(state.newest_epoch, record.epoch)
        if record.epoch != epoch:
            continue
        _merge(state, record)
    return state


def _merge(state: JournalState, record: JournalRecord) -> None:
    state.last_voted_round = max(state.last_voted_round, record.last_voted_round)
    for block in record.blocks:
        state.blocks[block.block_id] = block
    if record.high_qc is not None and (state.high_qc is None or record.high_qc.round > state.high_qc.round):
        state.high_qc = record.high_qc
    if record.entered_by is not None and (state.entered_by is None or record.entered_by.round > state.entered_by.round):
        state.entered_by = record.entered_by
    if record.vote is not None and (state.vote is None or record.vote.round > state.vote.round):
        state.vote = record.vote
    if record.timeout is not None and (state.timeout is None or record.timeout.round > state.timeout.round):
        state.timeout = record.timeout
    if record.proposed_id is not None:
        state.proposed_id = record.proposed_id

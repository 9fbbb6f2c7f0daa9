"""The chain as readable by every member and node, ordered."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from consensus.primitives.encoding import decode_value
from network.lab.privacy.hospital.attacked_chain import Block, Chain

_STATE_ROWS_MAX_COUNT = 10_000_000
_MARK_MIN_BYTES = 8


@dataclass(frozen=True, slots=True)
class RecordSeen:
    """A record's transaction: block time (ms), position, size, fields."""

    record_id: bytes
    at_ms: int
    height: int
    position: int
    wire_bytes: int
    commitment_root: bytes
    ciphertext_root: bytes
    sealed_metadata: bytes


@dataclass(slots=True)
class VisitSeen:
    """A visit: announcement, its time, and records in chain order."""

    owner: bytes
    ephemeral: bytes
    view_tag: int
    robot: bytes
    bucket_ms: int
    at_ms: int
    height: int
    position: int
    records: list[RecordSeen] = field(default_factory=list)
    closed_at_ms: int = 0
    """When the block was made that closes it; 0 if none does."""

    @property
    def ends_ms(self) -> int:
        return self.records[-1].at_ms if self.records else self.at_ms


@dataclass(frozen=True, slots=True)
class WordSeen:
    """A consent statement under a handle: `entry` of the contract, `key` M."""

    handle: bytes
    key: bytes
    entry: str
    at_ms: int


@dataclass(frozen=True, slots=True)
class LedgerView:
    """Visits by owner key in chain order, registrations (handle, M, ms), consent statements.

    `requests`: access requests as (owner key, block time in ms).
    """

    visits: dict[bytes, VisitSeen]
    registrations: tuple[tuple[bytes, bytes, int], ...]
    words: tuple[WordSeen, ...]
    requests: tuple[tuple[bytes, int], ...] = ()


def read_ledger(blocks: Sequence[Block]) -> LedgerView:
    visits: dict[bytes, VisitSeen] = {}
    registrations: list[tuple[bytes, bytes, int]] = []
    words: list[WordSeen] = []
    requests: list[tuple[bytes, int]] = []
    for block in blocks:
        for position, (transaction, receipt) in enumerate(zip(block.transactions, block.receipts, strict=True)):
            if not receipt.ok:
                continue
            body, arguments = transaction.body, transaction.arguments()
            match (body.contract, body.entry):
                case ("records", "open_visit"):
                    owner, ephemeral, view_tag, bucket_ms, _ = arguments
                    place = (bucket_ms, block.time_ms, block.height, position)
                    visits[owner] = VisitSeen(owner, ephemeral, view_tag, body.sender, *place)
                case ("records", "record"):
                    record_id, owner, *rest = arguments
                    place = (block.time_ms, block.height, position, len(transaction.wire))
                    visits[owner].records.append(RecordSeen(record_id, *place, *rest[:3]))
                case ("records", "close_visit"):
                    visits[arguments[0]].closed_at_ms = block.time_ms
                case ("identity", "register") if arguments[2] != "robot":
                    registrations.append((arguments[0], body.sender, block.time_ms))
                case ("access", "request"):
                    requests.append((body.sender, block.time_ms))
                case ("consent", entry) | ("rights", "object_to" as entry):
                    words.append(WordSeen(arguments[0], body.sender, entry, block.time_ms))
                case _:
                    pass
    return LedgerView(visits, tuple(registrations), tuple(words), tuple(requests))


def collect_marks(chain: Chain) -> set[bytes]:
    marks: set[bytes] = set()
    for key, value in chain.state.scan(b"", _STATE_ROWS_MAX_COUNT):
        rest = key.partition(b"\x00")[2]
        for part in (rest, *rest.split(b"/", 1)):
            _collect(part, marks)
        _collect(decode_value(value), marks)
    for block in chain.blocks:
        for transaction, receipt in zip(block.transactions, block.receipts, strict=True):
            _collect(transaction.arguments(), marks)
            _collect([transaction.body.sender, transaction.txid, transaction.body.salt], marks)
            for event in receipt.events:
                _collect(decode_value(event.data), marks)
    return marks


def _collect(value: Any, marks: set[bytes]) -> None:
    if isinstance(value, bytes):
        if len(value) >= _MARK_MIN_BYTES:
            marks.add(value)
    elif isinstance(value, str):
        _collect(value.encode(), marks)
    elif isinstance(value, dict):
        for key, item in value.items():
            _collect(key, marks)
            _collect(item, marks)
    elif isinstance(value, list | tuple):
        for item in value:
            _collect(item, marks)

"""Where two nodes differ: first block, first state key, its writing transaction."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from msgspec import UNSET, UnsetType
from msgspec.structs import replace

from consensus.chain.block import Block, Header, Receipts, compute_receipts_root, compute_transactions_root
from consensus.chain.transaction import decode_transaction
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode, decode_value
from consensus.primitives.hashing import sha256
from contracts.state.view import Overlay, StateView
from network.ledger_diff.block_replay import Base, Replay, Writer, execute_on, find_writers
from network.ledger_diff.difference_answers import ComparedHeader, DifferingKey, KeyWriter, NodeDiffAnswer
from network.ledger_diff.ledger_comparison import (
    Comparison,
    KeyDifference,
    compare_blocks,
    compare_states,
    newest_height,
    read_block,
)
from node.execution.execution_machines import Machine
from node.storage.ledger_store import LedgerSnapshot

BROUGHT_UP_MAX_COUNT = 5_000
VALUE_SHOWN_MAX_CHARS = 400

Ledgers = tuple[LedgerSnapshot, LedgerSnapshot]


@dataclass(slots=True)
class Difference:
    """A ledger comparison side by side; `keys` in order of writing."""

    comparison: Comparison
    heights: tuple[int, int]
    earliest: tuple[int, int]
    writers: dict[bytes, tuple[Writer | None, Writer | None]] = field(default_factory=dict)
    true_values: dict[bytes, bytes | None] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)


def _say_nothing(_height: int) -> None:
    pass


class LedgerDiff:
    """Compares two open ledgers of one chain. `open_base` gives the replay's base."""

    def __init__(
        self,
        ledgers: Ledgers,
        machine: Machine,
        open_base: Callable[[], Base],
        progress: Callable[[int], None] = _say_nothing,
        *,
        full: bool = False,
    ) -> None:
        self._ledgers = ledgers
        self._machine = machine
        self._open_base = open_base
        self._progress = progress
        self._full = full

    def run(self) -> Difference:
        """Raises STORAGE_DAMAGED if a ledger holds no block."""
        first, second = self._ledgers
        heights = newest_height(first), newest_height(second)
        blocks = compare_blocks(first, second)
        found = Difference(blocks, heights, (first.earliest_height, second.earliest_height))
        if blocks.kind == "header":
            self._look_into_fork(found)
            return found
        states = self._compare_states(found)
        if states is None:
            return found
        if blocks.is_same:
            found.comparison = states
            states.headers_from, states.bodies_from = blocks.headers_from, blocks.bodies_from
        elif states.keys:
            blocks.keys = states.keys
        if states.keys:
            self._find_writers(found, max(heights))
        return found

    # State

    def _compare_states(self, found: Difference) -> Comparison | None:
        top = max(found.heights)
        header = self._header(top)
        try:
            views = [self._bring_up(ledger, top) for ledger in self._ledgers]
        except BlockRobotError as error:
            found.notes.append(f"The states could not be brought to one height: {error.detail}")
            return None
        return compare_states(views[0], views[1], header, full=self._full)

    def _bring_up(self, ledger: LedgerSnapshot, top: int) -> StateView:
        """Raises BLOCK_PRUNED."""
        height = newest_height(ledger)
        if top - height > BROUGHT_UP_MAX_COUNT:
            raise BlockRobotError("BLOCK_PRUNED", f"One node is {top - height} blocks behind: let it catch up first.")
        view: StateView = ledger
        writes: dict[bytes, bytes | None] = {}
        pages: dict[bytes, bytes | None] = {}
        for number in range(height + 1, top + 1):
            block = read_block(self._ledgers, number)
            if block is None:
                raise BlockRobotError("BLOCK_PRUNED", f"No node here holds the body of block {number}.")
            overlay, _ = execute_on(self._machine, view, block)
            writes |= overlay.writes
            pages |= overlay.page_writes
            view = Overlay(ledger, writes, pages, overlay.state_root)
            self._progress(number)
        return view

    def _header(self, height: int) -> Header:
        block = read_block(self._ledgers, height)
        if block is None:
            raise BlockRobotError("STORAGE_DAMAGED", f"Neither ledger holds its newest block, {height}.")
        return block.header

    def _replay(self, found: Difference, until: int, keys: list[bytes]) -> Replay | None:
        try:
            replay = Replay(self._machine, self._open_base(), keys)
            replay.run(lambda height: read_block(self._ledgers, height), until, self._progress)
        except BlockRobotError as error:
            found.notes.append(f"Who wrote it could not be replayed: {error.detail} {error.next_step}")
            return None
        return replay

    def _find_writers(self, found: Difference, until: int) -> None:
        keys = [item.key for item in found.comparison.keys]
        replay = self._replay(found, until, keys)
        if replay is None:
            return
        for key in keys:
            writer = replay.writers.get(key)
            found.writers[key] = (writer, writer)
            found.true_values[key] = replay.state.get(key)
        found.comparison.keys.sort(key=lambda item: (_height_of(found.writers[item.key][0]), item.key))

    # Forks

    def _look_into_fork(self, found: Difference) -> None:
        blocks = [None if data is None else decode(data, Block) for data in self._at(found.comparison.height)]
        if blocks[0] is None or blocks[1] is None:
            found.notes.append("The bodies of the differing blocks were pruned.")
            return
        replay = self._replay(found, found.comparison.height - 1, [])
        if replay is None:
            return
        writes: list[Mapping[bytes, bytes | None]] = []
        for name, block in zip("AB", blocks, strict=True):
            assert block is not None
            overlay, is_equal = execute_on(self._machine, replay.state, block)
            writes.append(overlay.writes)
            if not is_equal:
                found.notes.append(
                    f"Executed here, the block of {name} gives another state root than its header names."
                )
        for key in sorted(writes[0].keys() | writes[1].keys()):
            values = tuple(side.get(key, replay.state.get(key)) for side in writes)
            if values[0] != values[1]:
                found.comparison.keys.append(KeyDifference(key, (values[0], values[1])))
                sides = [find_writers(self._machine, replay.state, block, [key]) for block in blocks if block]
                here, there = (side[key] if key in made else None for side, made in zip(sides, writes, strict=True))
                found.writers[key] = (here, there)

    def _at(self, height: int) -> list[bytes | None]:
        return [ledger.block(height) for ledger in self._ledgers]


def _height_of(writer: Writer | None) -> int:
    return 0 if writer is None else writer.height


# In words


def describe_key(key: bytes) -> dict[str, str]:
    contract, _, rest = key.partition(b"\x00")
    return {"contract": contract.decode("utf-8", "replace"), "key": _readable(rest), "flat_key": key.hex()}


def _readable(key: bytes) -> str:
    end = 0
    while end < len(key) and 0x20 < key[end] < 0x7F:
        end += 1
    if end == len(key):
        return key.decode()
    end = key.rfind(b"/", 0, end) + 1
    return key[:end].decode() + key[end:].hex()


def _describe_value(value: bytes | None) -> str | None:
    if value is None:
        return None
    try:
        text = repr(decode_value(value))
    except BlockRobotError:
        text = f"{len(value)} bytes that are no value: {value.hex()}"
    return text if len(text) <= VALUE_SHOWN_MAX_CHARS else text[:VALUE_SHOWN_MAX_CHARS] + "..."


def _describe_writer(writer: Writer | None) -> KeyWriter | None:
    if writer is None:
        return None
    body = None if writer.transaction is None else writer.transaction.body
    return KeyWriter(
        height=writer.height,
        block_id=writer.block_id.hex(),
        txid=None if writer.transaction is None else writer.transaction.txid.hex(),
        call=None if body is None else f"{body.contract}.{body.entry}",
        sender=None if body is None else body.sender.hex(),
    )


def _right(found: Difference, item: KeyDifference) -> str | None:
    if item.key in found.true_values:
        told = [value == found.true_values[item.key] for value in item.values]
        told = [fits and (agrees or not any(item.agrees)) for fits, agrees in zip(told, item.agrees, strict=True)]
    else:
        told = list(item.agrees)
    return "A" if told == [True, False] else "B" if told == [False, True] else None


def _describe_header(data: bytes | None) -> ComparedHeader | None:
    if data is None:
        return None
    header = decode(data, Header)
    return ComparedHeader(
        block_id=sha256(data).hex(),
        parent_id=header.parent_id.hex(),
        epoch=header.epoch,
        round=header.round,
        producer=header.producer,
        state_root=header.state_root.hex(),
        transactions_root=header.transactions_root.hex(),
    )


def _fits_header(ledger: LedgerSnapshot, height: int) -> bool:
    data, receipts = ledger.block(height), ledger.receipts(height)
    try:
        block = decode(data or b"", Block)
        told = compute_receipts_root(decode(receipts or b"", Receipts).receipts)
        txids = [decode_transaction(wire).txid for wire in block.transactions]
    except BlockRobotError:
        return False
    header = block.header
    return header.receipts_root == told and compute_transactions_root(txids) == header.transactions_root


def _describe_key(found: Difference, item: KeyDifference) -> DifferingKey:
    writers = found.writers.get(item.key, (None, None))
    return DifferingKey(
        **describe_key(item.key),
        values=dict(zip("AB", map(_describe_value, item.values), strict=True)),
        right=_right(found, item),
        written_by=dict(zip("AB", map(_describe_writer, writers), strict=True)),
    )


def describe_difference(found: Difference, names: tuple[str, str], ledgers: Ledgers) -> NodeDiffAnswer:
    comparison = found.comparison
    same = NodeDiffAnswer(
        same=comparison.is_same and not found.notes,
        kind=comparison.kind,
        nodes=dict(zip("AB", names, strict=True)),
        heights=dict(zip("AB", found.heights, strict=True)),
        earliest_heights=dict(zip("AB", found.earliest, strict=True)),
        headers_compared_from=comparison.headers_from,
        bodies_compared_from=comparison.bodies_from,
        notes=found.notes,
    )
    if comparison.is_same:
        return same
    height = comparison.height
    if comparison.kind == "state" and comparison.keys:
        height = _height_of(found.writers.get(comparison.keys[0].key, (None, None))[0]) or height
    right: str | UnsetType | None = UNSET
    if comparison.kind in {"body", "receipts"}:
        fits = [_fits_header(ledger, height) for ledger in ledgers]
        right = "A" if fits == [True, False] else "B" if fits == [False, True] else None
    return replace(
        same,
        first_block=height,
        first_block_is_at_most=comparison.kind == "header" and 0 < comparison.headers_from == comparison.height,
        headers=dict(zip("AB", map(_describe_header, comparison.headers), strict=True)),
        keys=[_describe_key(found, item) for item in comparison.keys],
        keys_are_all=not comparison.is_cut,
        damaged_pages=comparison.damaged_pages,
        right=right,
    )

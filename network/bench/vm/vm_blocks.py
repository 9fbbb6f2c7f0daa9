"""Full blocks of `records.record`, executed on a state with a realistically deep trie."""

from __future__ import annotations

import time
from collections.abc import Callable

from consensus.chain.transaction import Transaction, decode_transaction, sign_transaction
from consensus.limits import BLOCK_GAS_MAX, BLOCK_TRANSACTIONS_MAX_COUNT, SEALED_METADATA_BYTES, TIME_BUCKET_MS
from consensus.primitives.encoding import encode_value, u64
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.records.commitments import derive_record_id
from consensus.state import identity
from consensus.state.keys import flat_prefix
from contracts.execution.executor import execute_block
from contracts.execution.results import BlockContext, BlockResult
from contracts.lifecycle.registry import load_contracts
from contracts.state.view import MemoryState, Overlay, StateView

CHAIN_ID = bytes(32)
NOW_MS = TIME_BUCKET_MS * 5_000_000
PURPOSE = "bench"
UNFINALIZED_BLOCKS_COUNT = 3
ENTRIES_COUNT = 20_000
_OWNERS_COUNT = 20
_ROBOT = PrivateKey(sha256(b"the robot of the benchmark"))
_OWNERS = tuple(b"\x03" + sha256(b"owner" + u64(number)) for number in range(_OWNERS_COUNT))

Execute = Callable[[StateView, int, int, list[Transaction]], BlockResult]
"""What executes a block: parent, height, time in ms, transactions."""


def build_state(entries_count: int) -> MemoryState:
    robot = {"handle": bytes(32), "role": "robot", "org": "bench", "status": "active", "since": 0}
    entries = {flat_prefix("filler") + sha256(u64(number)): u64(number) for number in range(entries_count)}
    entries[identity.MEMBER.key(_ROBOT.public_key)] = encode_value(robot)
    entries[identity.PURPOSE.key(PURPOSE)] = encode_value(True)
    state = MemoryState()
    state.apply(entries)
    visits = [_sign("open_visit", [owner, _OWNERS[0], 7, NOW_MS, PURPOSE]) for owner in _OWNERS]
    result = execute_in_process(state, 1, NOW_MS, visits)
    _require_all(result)
    state.absorb(result.writes, result.page_writes, result.state_root)
    return state


def _sign(entry: str, arguments: list[object]) -> Transaction:
    signed = sign_transaction(
        _ROBOT,
        chain_id=CHAIN_ID,
        contract="records",
        entry=entry,
        arguments=arguments,
        valid_until_ms=NOW_MS + 60_000,
        salt=sha256(encode_value(arguments))[:8],
    )
    return decode_transaction(signed.wire)


def sign_record(number: int) -> Transaction:
    seed = sha256(u64(number))
    metadata = bytes(SEALED_METADATA_BYTES)
    owner = _OWNERS[number % _OWNERS_COUNT]
    return _sign(
        "record", [derive_record_id(owner, seed), owner, seed, sha256(seed), metadata, NOW_MS, NOW_MS + 1_000_000]
    )


def execute_in_process(parent: StateView, height: int, time_ms: int, transactions: list[Transaction]) -> BlockResult:
    context = BlockContext(chain_id=CHAIN_ID, height=height, time_ms=time_ms)
    return execute_block(parent, load_contracts(), context, transactions)


def _require_all(result: BlockResult) -> None:
    refused = [receipt for receipt in result.receipts if not receipt.ok]
    if refused or result.left_out:
        raise RuntimeError(f"a call of the benchmark failed: {refused[:1]}, left out {len(result.left_out)}")


class BlockBench:
    """A chain of full record blocks with `calls_a_block` calls each."""

    def __init__(self, entries_count: int = ENTRIES_COUNT) -> None:
        self.state = build_state(entries_count)
        self._height = 1
        self._number = 0
        self._unfinalized: list[Overlay] = []
        gas = execute_in_process(self.state, 2, NOW_MS, [sign_record(0)]).gas_used
        self.calls_a_block = min(BLOCK_GAS_MAX // (gas + gas // 50), BLOCK_TRANSACTIONS_MAX_COUNT)

    @property
    def head(self) -> StateView:
        return self._unfinalized[-1] if self._unfinalized else self.state

    def next_transactions(self) -> list[Transaction]:
        first, self._number = self._number, self._number + self.calls_a_block
        return [sign_record(number) for number in range(first, self._number)]

    def execute(self, transactions: list[Transaction], execute: Execute = execute_in_process) -> BlockResult:
        """As the new head. Raises RuntimeError if a call is refused."""
        self._height += 1
        result = execute(self.head, self._height, NOW_MS + 1, transactions)
        _require_all(result)
        self._unfinalized.append(Overlay(self.head, result.writes, result.page_writes, result.state_root))
        if len(self._unfinalized) > UNFINALIZED_BLOCKS_COUNT:
            oldest = self._unfinalized.pop(0)
            self.state.absorb(oldest.writes, oldest.page_writes, oldest.state_root)
            self._unfinalized[0].rebase(self.state)
        return result


def measure_block_call_us(seconds: float) -> tuple[list[float], int]:
    """CPU µs per call for each block, and calls per block: decoding, execution, receipts, trie and roots, but no
    signatures, storage or second process. At least two blocks.
    """
    bench = BlockBench()
    bench.execute(bench.next_transactions())
    each: list[float] = []
    spent = 0.0
    while spent < seconds or len(each) < 2:
        transactions = bench.next_transactions()
        started = time.thread_time()
        bench.execute(transactions)
        took = time.thread_time() - started
        spent += took
        each.append(took / bench.calls_a_block * 1e6)
    return each, bench.calls_a_block

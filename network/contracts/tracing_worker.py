"""`python -I -m network.contracts.tracing_worker`: executes a chain up to one transaction, sandboxed."""

from __future__ import annotations

import os
import signal
import sys

import msgspec

from consensus.chain.block import Block
from consensus.chain.genesis import genesis_from_json
from consensus.chain.transaction import decode_transaction
from consensus.errors import BlockRobotError
from consensus.limits import CALL_GAS_MAX
from consensus.primitives.encoding import decode, decode_value
from consensus.state.lifecycle import MACHINE_TABLE
from contracts.execution.call_host import CallHost
from contracts.execution.contract_machine import ContractMachine
from contracts.execution.executor import execute_transaction
from contracts.execution.results import BlockContext
from contracts.kit.arguments import format_short
from contracts.kit.engine import watched_stack
from contracts.kit.recorder import Recorder
from contracts.kit.tracing import Trace
from contracts.lifecycle.applying_changes import apply_due_changes
from contracts.lifecycle.catalogue import Catalogue, read_source_of
from contracts.state.view import MemoryState
from contracts.vm import CompiledContract, InternalFault, compile_contract
from contracts.worker.sandbox import enter_sandbox
from contracts.worker.wire import Pipe, SandboxFeature
from network.ledger_diff.block_replay import base_of_genesis, execute_on

MEMORY_MAX_BYTES = 4 * 1024**3
"""The whole state of the chain is held in memory."""


class Outcome(msgspec.Struct, frozen=True):
    """A proved receipt's result of the transaction to trace."""

    height: int
    index: int
    code: str
    message: str
    line: int | None
    gas_used: int


class Begin(msgspec.Struct, frozen=True, tag=True):
    """First message: the genesis file and what to trace."""

    genesis_json: str
    wanted: Outcome


class NextBlock(msgspec.Struct, frozen=True, tag=True):
    """The next block, encoded."""

    block: bytes


class SandboxEntered(msgspec.Struct, frozen=True, tag=True):
    """The sandbox is active: its parts."""

    parts: tuple[SandboxFeature, ...]


class BlockReplayed(msgspec.Struct, frozen=True, tag=True):
    """The block gave its header's root."""

    height: int


class Traced(msgspec.Struct, frozen=True, tag=True):
    """Result of the transaction."""

    trace: Trace


class Failed(msgspec.Struct, frozen=True, tag=True):
    """A block with a wrong result, or an interpreter failure."""

    code: str
    detail: str


TO_WORKER: msgspec.msgpack.Decoder[Begin | NextBlock] = msgspec.msgpack.Decoder(Begin | NextBlock)
FROM_WORKER: msgspec.msgpack.Decoder[SandboxEntered | BlockReplayed | Traced | Failed] = msgspec.msgpack.Decoder(
    SandboxEntered | BlockReplayed | Traced | Failed
)


class _Tracer:
    """A chain executed from genesis."""

    def __init__(self, begin: Begin) -> None:
        genesis = genesis_from_json(begin.genesis_json)
        self._chain_id = genesis.chain_id
        self._machine = ContractMachine.of_genesis(genesis)
        self._state = base_of_genesis(genesis).state
        self._wanted = begin.wanted

    def take(self, block: Block) -> BlockReplayed | Traced:
        """Raises BLOCK_INVALID."""
        if block.header.height == self._wanted.height:
            return Traced(_trace_in(self._state, self._chain_id, block, self._wanted))
        overlay, is_right = execute_on(self._machine, self._state, block)
        if not is_right:
            raise BlockRobotError("BLOCK_INVALID", f"Block {block.header.height} gives another state than it names.")
        self._state.absorb(overlay.writes, overlay.page_writes, overlay.state_root)
        return BlockReplayed(block.header.height)


def _trace_in(state: MemoryState, chain_id: bytes, block: Block, wanted: Outcome) -> Trace:
    header = block.header
    context = BlockContext(chain_id=chain_id, height=header.height, time_ms=header.timestamp_ms)
    host, catalogue = CallHost(state), Catalogue()
    contracts = apply_due_changes(host, catalogue, context, gives_up=header.gives_up_change)
    transactions = [decode_transaction(wire) for wire in block.transactions]
    for before in transactions[: wanted.index]:
        if execute_transaction(host, contracts, context, before, CALL_GAS_MAX).ok:
            host.keep()
    transaction, recorder = transactions[wanted.index], Recorder()
    watched, sources = _watched(host, recorder)
    with watched_stack():
        recorder.begin(tracing=True)
        again = execute_transaction(host, watched, context, transaction, CALL_GAS_MAX)
        recorder.finish(transaction.body.contract, 0, again.gas_used)
    if (again.code, again.gas_used) != (wanted.code, wanted.gas_used):
        raise BlockRobotError("BLOCK_INVALID", f"Executed again it came to {again.code}, not to {wanted.code}.")
    body = transaction.body
    arguments = ", ".join(format_short(value) for value in transaction.arguments())
    return Trace(
        title=f"{body.contract}.{body.entry}({arguments}) by 0x{body.sender.hex()[:12]} in block {header.height}",
        code=wanted.code,
        message=wanted.message,
        line=wanted.line,
        gas_used=wanted.gas_used,
        steps=tuple(recorder.steps),
        left_out_count=recorder.left_out_count,
        sources=sources,
    )


def _watched(state: CallHost, recorder: Recorder) -> tuple[dict[str, CompiledContract], dict[str, str]]:
    table = decode_value(state.get(MACHINE_TABLE.flat) or b"\x80")
    sources = {name: read_source_of(state, row[1]) for name, row in table.items() if row[2]}
    return {
        name: compile_contract(source, name, watch=recorder.watch(name)) for name, source in sources.items()
    }, sources


def main() -> int:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.umask(0o077)
    pipe = Pipe(0, 1)
    begin = pipe.receive(TO_WORKER)
    if not isinstance(begin, Begin):
        return 2
    try:
        tracer = _Tracer(begin)
        pipe.send(SandboxEntered(enter_sandbox((), MEMORY_MAX_BYTES)))
        while True:
            message = pipe.receive(TO_WORKER)
            if not isinstance(message, NextBlock):
                return 2
            pipe.send(tracer.take(decode(message.block, Block)))
    except BlockRobotError as error:
        pipe.send(Failed(error.code, error.detail))
    except InternalFault as error:
        pipe.send(Failed("CONTRACT_WORKER_FAILED", str(error)))
    except EOFError:
        pass
    return 0


if __name__ == "__main__":
    sys.exit(main())

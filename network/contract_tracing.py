"""Executes a final transaction again, watched: which lines ran, with which values. Must never trust a node's blocks.

Every block from genesis on is executed here, on a state of its own; each has to give the root that its header names, so
that what is traced is what the chain did. Nothing is sent to the network.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass

from clients.sdk.answers import Answer, read_answer, read_hex
from clients.sdk.http import NetworkClient
from clients.sdk.receipts import FinalReceipt
from consensus.block import Block
from consensus.errors import BlockRobotError
from consensus.limits import CALL_GAS_MAX
from consensus.primitives.encoding import decode, decode_value
from consensus.primitives.keys import PrivateKey
from consensus.transaction import Transaction, decode_transaction
from contracts.execution.call_host import CallHost
from contracts.execution.catalogue import TABLE_KEY, Catalogue, read_source_of
from contracts.execution.executor import execute_transaction
from contracts.execution.opening import open_block
from contracts.execution.results import BlockContext
from contracts.kit.chain import watched_stack
from contracts.kit.recorder import Recorder
from contracts.kit.telling import told_short
from contracts.kit.tracing import Trace
from contracts.state.view import MemoryState
from contracts.vm import CompiledContract, compile_contract
from node.replaying import base_of_genesis, execute_on, machine_of

AT_ONCE_COUNT = 16
FIND_TIMEOUT_MS = 5_000

Progress = Callable[[int, int], None]


class BlockDocument(Answer, frozen=True):
    """A finalized block, in hexadecimal."""

    block: str


@dataclass(frozen=True, slots=True)
class TracedTransaction:
    """A final transaction with the proved receipt and how it went."""

    receipt: FinalReceipt
    transaction: Transaction
    trace: Trace


async def _fetch_blocks(client: NetworkClient, key: PrivateKey, first: int, last: int) -> list[Block]:
    async def fetch(height: int) -> Block:
        content = await client.ask_any(lambda node: client.ask_node(node, "GET", f"/v1/blocks/{height}", key=key))
        return decode(read_hex(read_answer(content, BlockDocument).block), Block)

    return list(await asyncio.gather(*[fetch(height) for height in range(first, last + 1)]))


async def trace_transaction(
    client: NetworkClient, key: PrivateKey, txid: bytes, progress: Progress = lambda _done, _all: None
) -> TracedTransaction:
    """Find a final transaction, and execute the chain up to it. `progress` is told the height and the last one.

    Raises TRANSACTION_NOT_FINAL_IN_TIME for one that nobody knows, BLOCK_PRUNED where no node has all blocks,
    BLOCK_INVALID if blocks do not give the roots that they name.
    """
    try:
        receipt = await client.wait_final(txid, FIND_TIMEOUT_MS)
    except BlockRobotError as error:
        if error.code != "TRANSACTION_NOT_FINAL_IN_TIME":
            raise
        raise BlockRobotError(error.code, "No node has it as final: it waits still, or was never sent here.") from None
    machine, base = machine_of(client.genesis), base_of_genesis(client.genesis)
    state, parent_id = base.state, base.block_id
    for first in range(1, receipt.height + 1, AT_ONCE_COUNT):
        last = min(first + AT_ONCE_COUNT - 1, receipt.height)
        for block in await _fetch_blocks(client, key, first, last):
            if block.header.parent_id != parent_id:
                raise BlockRobotError(
                    "BLOCK_INVALID", f"Block {block.header.height} does not follow the one before it."
                )
            parent_id = block.block_id
            if block.header.height == receipt.height:
                if block.block_id != receipt.block_id:
                    raise BlockRobotError("BLOCK_INVALID", "The transaction's block is not the one that was proved.")
                return _trace_in(state, client.genesis.chain_id, block, receipt)
            overlay, is_right = execute_on(machine, state, block)
            if not is_right:
                raise BlockRobotError(
                    "BLOCK_INVALID", f"Block {block.header.height} gives another state than it names."
                )
            state.absorb(overlay.writes, overlay.page_writes, overlay.state_root)
            progress(block.header.height, receipt.height)
    raise BlockRobotError("NOT_FOUND", "Genesis has no transactions.")


def _trace_in(state: MemoryState, chain_id: bytes, block: Block, receipt: FinalReceipt) -> TracedTransaction:
    """Execute a block up to a transaction, and that one watched."""
    header = block.header
    context = BlockContext(chain_id=chain_id, height=header.height, time_ms=header.timestamp_ms)
    host, catalogue = CallHost(state), Catalogue()
    contracts = open_block(host, catalogue, context)
    transactions = [decode_transaction(wire) for wire in block.transactions]
    for before in transactions[: receipt.index]:
        if execute_transaction(host, contracts, context, before, CALL_GAS_MAX).ok:
            host.keep()
    transaction, recorder = transactions[receipt.index], Recorder()
    watched, sources = _watched(host, recorder)
    with watched_stack():
        recorder.begin(tracing=True)
        again = execute_transaction(host, watched, context, transaction, CALL_GAS_MAX)
        recorder.finish(transaction.body.contract, 0, again.gas_used)
    if (again.code, again.gas_used) != (receipt.code, receipt.gas_used):
        raise BlockRobotError("BLOCK_INVALID", f"Executed again it came to {again.code}, not to {receipt.code}.")
    body = transaction.body
    arguments = ", ".join(told_short(value) for value in transaction.arguments())
    trace = Trace(
        title=f"{body.contract}.{body.entry}({arguments}) by 0x{body.sender.hex()[:12]} in block {header.height}",
        code=receipt.code,
        message=receipt.message,
        line=receipt.line,
        gas_used=receipt.gas_used,
        steps=tuple(recorder.steps),
        left_out_count=recorder.left_out_count,
        sources=sources,
    )
    return TracedTransaction(receipt, transaction, trace)


def _watched(state: CallHost, recorder: Recorder) -> tuple[dict[str, CompiledContract], dict[str, str]]:
    """Compile the contracts that answer on a state so that they tell the recorder; also return their sources."""
    table = decode_value(state.get(TABLE_KEY) or b"\x80")
    sources = {name: read_source_of(state, row[1]) for name, row in table.items() if row[2]}
    return {
        name: compile_contract(source, name, watch=recorder.watch(name)) for name, source in sources.items()
    }, sources

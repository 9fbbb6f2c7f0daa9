"""Re-executes a final transaction with a trace of lines and values.

Every block from genesis on runs in a sandboxed process and has to give its header's root. Nothing is sent to the
network.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

from clients.sdk.chain.receipts import FinalReceipt
from clients.sdk.network_client import NetworkClient
from clients.sdk.node_answers import read_answer, read_hex
from consensus.api_documents import BlockAnswer
from consensus.chain.block import Block
from consensus.chain.genesis import Genesis, genesis_to_json
from consensus.chain.transaction import Transaction, decode_transaction
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode
from consensus.primitives.keys import PrivateKey
from contracts.kit.tracing import Trace
from contracts.worker.handle import SandboxedProcess
from network.contracts.tracing_worker import (
    FROM_WORKER,
    Begin,
    BlockReplayed,
    Failed,
    NextBlock,
    Outcome,
    SandboxEntered,
    Traced,
)

TRACER_MODULE = "network.contracts.tracing_worker"
AT_ONCE_COUNT = 16
FIND_TIMEOUT_MS = 5_000

Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True)
class TracedTransaction:
    """A final transaction with its proved receipt and trace."""

    receipt: FinalReceipt
    transaction: Transaction
    trace: Trace


async def _fetch_blocks(client: NetworkClient, key: PrivateKey, first: int, last: int) -> list[bytes]:
    async def fetch(height: int) -> bytes:
        content = await client.with_any_node(lambda node: client.ask_node(node, "GET", f"/v1/blocks/{height}", key=key))
        return read_hex(read_answer(content, BlockAnswer).block)

    return list(await asyncio.gather(*[fetch(height) for height in range(first, last + 1)]))


async def trace_transaction(
    client: NetworkClient, key: PrivateKey, txid: bytes, progress: Progress = lambda _done, _all: None
) -> TracedTransaction:
    """Find a final transaction and execute the chain up to it; `progress` receives (height, last).

    Raises TRANSACTION_NOT_FINAL_IN_TIME if unknown, BLOCK_PRUNED, BLOCK_INVALID on a wrong root,
    CONTRACT_WORKER_FAILED.
    """
    try:
        receipt = await client.wait_final(txid, FIND_TIMEOUT_MS)
    except BlockRobotError as error:
        if error.code != "TRANSACTION_NOT_FINAL_IN_TIME":
            raise
        raise BlockRobotError(error.code, "No node has it as final: it waits still, or was never sent here.") from None
    with SandboxedTracer(client.genesis, receipt) as tracer:
        parent_id = client.genesis.block_id
        for first in range(1, receipt.height + 1, AT_ONCE_COUNT):
            last = min(first + AT_ONCE_COUNT - 1, receipt.height)
            for encoded in await _fetch_blocks(client, key, first, last):
                block = decode(encoded, Block)
                if block.header.parent_id != parent_id:
                    raise BlockRobotError(
                        "BLOCK_INVALID", f"Block {block.header.height} does not follow the one before it."
                    )
                parent_id = block.block_id
                if block.header.height == receipt.height and block.block_id != receipt.block_id:
                    raise BlockRobotError("BLOCK_INVALID", "The transaction's block is not the one that was proved.")
                trace = await asyncio.to_thread(tracer.take, encoded)
                if trace is not None:
                    return TracedTransaction(receipt, decode_transaction(block.transactions[receipt.index]), trace)
                progress(block.header.height, receipt.height)
    raise BlockRobotError("NOT_FOUND", "Genesis has no transactions.")


class SandboxedTracer:
    """Sandboxed process that executes the chain; context manager. Foreign sources run only there."""

    def __init__(self, genesis: Genesis, receipt: FinalReceipt) -> None:
        wanted = Outcome(receipt.height, receipt.index, receipt.code, receipt.message, receipt.line, receipt.gas_used)
        self._begin = Begin(genesis_to_json(genesis), wanted)

    def __enter__(self) -> Self:
        """Raises CONTRACT_WORKER_FAILED."""
        self._process = SandboxedProcess(TRACER_MODULE)
        try:
            entered = self._ask(self._begin)
        except BaseException:
            self._process.close()
            raise
        self.parts = entered.parts if isinstance(entered, SandboxEntered) else ()
        return self

    def __exit__(self, *exception: object) -> None:
        self._process.close()

    def take(self, encoded: bytes) -> Trace | None:
        """Execute the next block; return a trace if it holds the transaction. Raises BLOCK_INVALID."""
        answer = self._ask(NextBlock(encoded))
        return answer.trace if isinstance(answer, Traced) else None

    def _ask(self, message: Begin | NextBlock) -> SandboxEntered | BlockReplayed | Traced:
        answer = self._process.ask(message, FROM_WORKER)
        if isinstance(answer, Failed):
            raise BlockRobotError(answer.code, answer.detail)
        return answer

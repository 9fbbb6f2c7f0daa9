"""Reads one transaction out of the final block that holds it.

What is returned has the id that was named; that it is final, and what became of it, its receipt's proof tells.
"""

from __future__ import annotations

from clients.sdk.connections import NodeAddress
from clients.sdk.network_client import NetworkClient
from clients.sdk.node_answers import Answer, read_answer, read_hex
from consensus.chain.block import Block
from consensus.chain.transaction import Transaction, decode_transaction
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode
from consensus.primitives.keys import PrivateKey


class BlockAnswer(Answer, frozen=True):
    """One block, in its canonical bytes."""

    block: str


async def read_transaction(client: NetworkClient, key: PrivateKey, height: int, txid: bytes) -> Transaction:
    """Return a transaction as it was sent, in the session of `key`, a member's.

    Raises PROOF_INVALID if the node's block does not hold it, BLOCK_PRUNED if no node has that block any more.
    """

    async def ask(node: NodeAddress) -> Transaction:
        content = await client.ask_node(node, "GET", f"/v1/blocks/{height}", key=key)
        for wire in decode(read_hex(read_answer(content, BlockAnswer).block), Block).transactions:
            transaction = decode_transaction(wire)
            if transaction.txid == txid:
                return transaction
        raise BlockRobotError("PROOF_INVALID", f"Block {height} of the node does not hold the transaction.")

    return await client.with_any_node(ask)

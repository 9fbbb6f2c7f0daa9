"""Read one transaction from its block, checked only by id; finality needs the receipt's proof."""

from __future__ import annotations

from clients.sdk.connections import NodeAddress
from clients.sdk.network_client import NetworkClient
from clients.sdk.node_answers import read_answer, read_hex
from consensus.api_documents import BlockAnswer
from consensus.chain.block import Block
from consensus.chain.transaction import Transaction, decode_transaction
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode
from consensus.primitives.keys import PrivateKey


async def read_transaction(client: NetworkClient, key: PrivateKey, height: int, txid: bytes) -> Transaction:
    """Return a transaction, in a member's session. Raises PROOF_INVALID, BLOCK_PRUNED."""

    async def ask(node: NodeAddress) -> Transaction:
        content = await client.ask_node(node, "GET", f"/v1/blocks/{height}", key=key)
        for wire in decode(read_hex(read_answer(content, BlockAnswer).block), Block).transactions:
            transaction = decode_transaction(wire)
            if transaction.txid == txid:
                return transaction
        raise BlockRobotError("PROOF_INVALID", f"Block {height} of the node does not hold the transaction.")

    return await client.with_any_node(ask)

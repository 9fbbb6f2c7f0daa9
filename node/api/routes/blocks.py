"""Finalized blocks, for explorers and auditors. Must never show a block that could still be undone."""

from __future__ import annotations

from aiohttp import web

from consensus.block import Block
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode
from consensus.primitives.hashing import sha256
from node.api.access import MEMBER
from node.api.documents import PAGE_MAX_COUNT, BlockAnswer, BlocksAnswer, BlockSummary
from node.api.pruned import require_kept
from node.api.routes.transactions import receipt_document
from node.api.routing import JSON, Answer, Call, Parameter, Route, json_answer


def _summary(block: Block) -> BlockSummary:
    header = block.header
    return BlockSummary(
        height=header.height,
        block_id=sha256(block.header_bytes).hex(),
        round=header.round,
        producer=header.producer,
        timestamp_ms=header.timestamp_ms,
        transaction_count=len(block.transactions),
        gas_used=header.gas_used,
    )


async def _list_blocks(call: Call) -> web.StreamResponse:
    first, limit = call.int_of("from_height"), call.int_of("limit")
    with call.services.ledger.snapshot() as snapshot:
        head = snapshot.header.height
        require_kept(snapshot, first, call.services.keepers)
        blocks = [snapshot.block(height) for height in range(first, min(first + limit, head + 1))]
        earliest = snapshot.earliest_height
    return json_answer(
        BlocksAnswer(
            head=head, earliest_height=earliest, blocks=[_summary(block) for block in blocks if block is not None]
        )
    )


async def _get_block(call: Call) -> web.StreamResponse:
    height = call.int_of("height")
    with call.services.ledger.snapshot() as snapshot:
        require_kept(snapshot, height, call.services.keepers)
        block, receipts = snapshot.block(height), snapshot.receipts(height)
    if block is None:
        raise BlockRobotError("NOT_FOUND", "There is no finalized block of this height here.")
    return json_answer(
        BlockAnswer(
            summary=_summary(block),
            block=encode(block).hex(),
            txids=[receipt.txid.hex() for receipt in receipts or ()],
            receipts=[receipt_document(receipt) for receipt in receipts or ()],
        )
    )


ROUTES = (
    Route(
        "GET",
        "/v1/blocks",
        "listBlocks",
        "Finalized blocks by height.",
        MEMBER,
        _list_blocks,
        Answer(JSON, BlocksAnswer, "A page of blocks."),
        parameters=(
            Parameter("from_height", "query", "The first height.", default=0),
            Parameter("limit", "query", "How many at most.", None, 1, PAGE_MAX_COUNT, 50),
        ),
        errors=("BLOCK_PRUNED",),
    ),
    Route(
        "GET",
        "/v1/blocks/{height}",
        "getBlock",
        "One finalized block with its receipts.",
        MEMBER,
        _get_block,
        Answer(JSON, BlockAnswer, "The block."),
        parameters=(Parameter("height", "path", "The height.", None),),
        errors=("NOT_FOUND", "BLOCK_PRUNED"),
    ),
)

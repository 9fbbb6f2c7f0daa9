"""Finalized blocks, for explorers and auditors."""

from __future__ import annotations

from aiohttp import web

from consensus.api_documents import PAGE_MAX_COUNT, BlockAnswer, BlocksAnswer, BlockSummary, ReceiptDocument, describe
from consensus.chain.block import Header
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode
from consensus.primitives.hashing import sha256
from node.api.access.metering import Steps
from node.api.access.route_access import MEMBER
from node.api.routing import JSON, Answer, Call, Parameter, Route, json_answer
from node.storage.ledger_view import BlockHead, LedgerView, PeersWithBlock, require_not_pruned


def _summary(head: BlockHead) -> BlockSummary:
    header = decode(head.header_bytes, Header)
    block_id = sha256(head.header_bytes).hex()
    return describe(BlockSummary, header, block_id=block_id, transaction_count=head.transactions_count or 0)


def _read_page(snapshot: LedgerView, peers_with_block: PeersWithBlock, first: int, limit: int) -> Steps[web.Response]:
    head = snapshot.header.height
    require_not_pruned(snapshot, first, peers_with_block)
    blocks: list[BlockSummary] = []
    for height in range(first, min(first + limit, head + 1)):
        found = snapshot.head(height)
        if found is not None:
            blocks.append(_summary(found))
        yield
    return json_answer(BlocksAnswer(head=head, earliest_height=snapshot.earliest_height, blocks=blocks))


def _read_block(snapshot: LedgerView, peers_with_block: PeersWithBlock, height: int) -> Steps[web.Response]:
    require_not_pruned(snapshot, height, peers_with_block)
    head, block = snapshot.head(height), snapshot.block_bytes(height)
    if head is None or block is None:
        raise BlockRobotError("NOT_FOUND", "There is no finalized block of this height here.")
    yield
    receipts = snapshot.receipts(height) or ()
    yield
    answer = BlockAnswer(
        summary=_summary(head),
        block=block.hex(),
        txids=[receipt.txid.hex() for receipt in receipts],
        receipts=[describe(ReceiptDocument, receipt) for receipt in receipts],
    )
    yield
    return json_answer(answer)


async def _list_blocks(call: Call) -> web.StreamResponse:
    first, limit = call.int_of("from_height"), call.int_of("limit")
    return await call.read(lambda snapshot: _read_page(snapshot, call.services.peers_with_block, first, limit))


async def _get_block(call: Call) -> web.StreamResponse:
    height = call.int_of("height")
    return await call.read(lambda snapshot: _read_block(snapshot, call.services.peers_with_block, height))


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

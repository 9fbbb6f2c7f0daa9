"""Submit transactions and follow them.

No session is needed: transactions are signed, and a txid suffices to ask.
"""

from __future__ import annotations

import msgspec
from aiohttp import web

from consensus.api_documents import ReceiptDocument, SubmitAnswer, SubmitOutcome, TransactionState, describe
from consensus.errors import BlockRobotError
from consensus.limits import TRANSACTION_SIZE_MAX_BYTES
from consensus.primitives.hashing import sha256
from node.api.access.metering import Steps
from node.api.access.route_access import ANYONE
from node.api.evidence import build_evidence
from node.api.problems import problem_document
from node.api.routing import JSON, MSGPACK, Answer, Body, Call, Parameter, Route, json_answer
from node.mempool.transaction_pool import SubmitResult
from node.storage.ledger_view import LedgerView, PeersWithBlock, require_not_pruned

BATCH_MAX_COUNT = 256
BATCH_MAX_BYTES = 1024 * 1024
WAIT_MAX_MS = 30_000
_wires = msgspec.msgpack.Decoder(list[bytes])


def _outcome(result: SubmitResult) -> SubmitOutcome:
    problem = None if result.error is None else problem_document(result.error)
    status = "accepted" if problem is None else "rejected"
    return SubmitOutcome(txid=result.txid.hex() if result.txid else None, status=status, error=problem)


async def _submit(call: Call) -> web.StreamResponse:
    content = await call.body()
    try:
        wires = _wires.decode(content)
    except msgspec.DecodeError as error:
        raise BlockRobotError("REQUEST_INVALID", f"The body is no list of byte strings: {error}.") from None
    if not 1 <= len(wires) <= BATCH_MAX_COUNT:
        raise BlockRobotError("REQUEST_INVALID", f"A batch holds 1 to {BATCH_MAX_COUNT} transactions.")
    results = await call.services.pool.submit(wires, call.source)
    return json_answer(SubmitAnswer(results=[_outcome(result) for result in results]))


def _find(
    snapshot: LedgerView, peers_with_block: PeersWithBlock, txid: bytes, *, with_evidence: bool
) -> Steps[TransactionState | None]:
    place = snapshot.locate(txid)
    if place is None:
        return None
    require_not_pruned(snapshot, place.height, peers_with_block)
    head, receipt = snapshot.head(place.height), snapshot.receipt(place.height, place.index)
    if head is None or receipt is None:
        raise BlockRobotError("NOT_FOUND", "The block of this transaction is no longer kept here.")
    yield
    return TransactionState(
        txid=txid.hex(),
        status="finalized",
        height=place.height,
        index=place.index,
        block_id=sha256(head.header_bytes).hex(),
        receipt=describe(ReceiptDocument, receipt),
        evidence=(yield from build_evidence(snapshot, place)) if with_evidence else None,
    )


async def _get_transaction(call: Call) -> web.StreamResponse:
    services = call.services
    txid = call.bytes_of("txid")
    wait_ms = call.int_of("wait_ms")
    with_evidence = call.int_of("evidence") == 1

    async def find() -> TransactionState | None:
        with services.ledger.snapshot() as snapshot:
            if snapshot.locate(txid) is None:
                return None  # so cheap that it waits for no other reading
        return await call.read(
            lambda snapshot: _find(snapshot, services.peers_with_block, txid, with_evidence=with_evidence)
        )

    state = await find()
    may_come = state is None and wait_ms > 0 and services.pool.status(txid) != "expired"
    if may_come:
        with call.hold_back() as allowed:
            is_final = allowed and await services.pool.wait_final(txid, wait_ms)
        if is_final:
            state = await find()
    if state is None:
        state = TransactionState(
            txid=txid.hex(),
            status=services.pool.status(txid),
            height=None,
            index=None,
            block_id=None,
            receipt=None,
            evidence=None,
        )
    return json_answer(state)


ROUTES = (
    Route(
        "POST",
        "/v1/transactions",
        "submitTransactions",
        "Submit signed transactions, up to 256 in one request.",
        ANYONE,
        _submit,
        Answer(JSON, SubmitAnswer, "What became of each, in order."),
        Body(MSGPACK, None, "A MessagePack list of transactions' wire bytes.", BATCH_MAX_BYTES),
        errors=("NODE_NOT_READY", "NODE_REMOVED", "CERTIFICATE_EXPIRED", "CERTIFICATE_REVOKED"),
    ),
    Route(
        "GET",
        "/v1/transactions/{txid}",
        "getTransaction",
        "Where a transaction is; with `wait_ms` the answer is held back until it is final, unless too many are.",
        ANYONE,
        _get_transaction,
        Answer(JSON, TransactionState, "pending, finalized, unknown or expired."),
        parameters=(
            Parameter("txid", "path", "The transaction's id.", 32),
            Parameter("wait_ms", "query", "How long to wait for finality, in ms.", maximum=WAIT_MAX_MS, default=0),
            Parameter("evidence", "query", "1 adds what proves the receipt to anyone.", maximum=1, default=0),
        ),
        errors=("NOT_FOUND", "BLOCK_PRUNED"),
    ),
)
assert BATCH_MAX_BYTES >= TRANSACTION_SIZE_MAX_BYTES

"""The newest finalized header, the headers below it, and the epochs.

Epochs are public, like genesis: checking a receipt needs them.
"""

from __future__ import annotations

from aiohttp import web

from consensus.api_documents import (
    EPOCHS_PAGE_MAX_COUNT,
    PAGE_MAX_COUNT,
    EpochsAnswer,
    FinalityAnswer,
    HeadersAnswer,
    finality_document,
)
from node.api.access.metering import Steps
from node.api.access.route_access import ANYONE, READER
from node.api.routing import JSON, Answer, Call, Parameter, Route, json_answer
from node.storage.ledger_view import LedgerView


async def _get_finality(call: Call) -> web.StreamResponse:
    with call.services.ledger.snapshot() as snapshot:
        return json_answer(FinalityAnswer(height=snapshot.header.height, finality=finality_document(snapshot.finality)))


async def _get_epochs(call: Call) -> web.StreamResponse:
    first = call.int_of("after") + 1
    epochs: list[str] = []
    with call.services.ledger.snapshot() as snapshot:
        for number in range(first, first + EPOCHS_PAGE_MAX_COUNT):
            proof = snapshot.epoch_proof(number)
            if proof is None:
                break
            epochs.append(proof.hex())
    return json_answer(EpochsAnswer(epochs=epochs))


def _read_headers(snapshot: LedgerView, first: int, limit: int) -> Steps[web.Response]:
    headers: list[str] = []
    for height in range(first, min(first + limit, snapshot.header.height + 1)):
        header = snapshot.header_bytes(height)
        if header is None:
            break
        headers.append(header.hex())
        yield
    return json_answer(HeadersAnswer(from_height=first, headers=headers))


async def _get_headers(call: Call) -> web.StreamResponse:
    first, limit = call.int_of("from_height"), call.int_of("limit")
    return await call.read(lambda snapshot: _read_headers(snapshot, first, limit))


ROUTES = (
    Route(
        "GET",
        "/v1/finality",
        "getFinality",
        "The newest finalized header with the proof that it is final.",
        READER,
        _get_finality,
        Answer(JSON, FinalityAnswer, "Height and proof."),
    ),
    Route(
        "GET",
        "/v1/epochs",
        "getEpochs",
        "The proofs by which a client that trusts no node follows the chain into its next epochs.",
        ANYONE,
        _get_epochs,
        Answer(JSON, EpochsAnswer, "The proofs, oldest first."),
        parameters=(Parameter("after", "query", "The epoch that the client is in.", maximum=(1 << 32) - 1, default=0),),
    ),
    Route(
        "GET",
        "/v1/headers",
        "getHeaders",
        "Consecutive finalized headers; each names the one before.",
        READER,
        _get_headers,
        Answer(JSON, HeadersAnswer, "The headers, lowest first."),
        parameters=(
            Parameter("from_height", "query", "The first height.", default=0),
            Parameter("limit", "query", "How many at most.", None, 1, PAGE_MAX_COUNT, PAGE_MAX_COUNT),
        ),
    ),
)

"""Receipts of consent given, refused or withdrawn."""

from __future__ import annotations

from aiohttp import web

from consensus.api_documents import ConsentReceiptAnswer, ConsentReceiptRequest
from consensus.errors import BlockRobotError
from node.api.access.metering import Steps
from node.api.access.route_access import MEMBER
from node.api.routing import JSON, Answer, Body, Call, Route, json_answer
from node.custody.coordination.consent_receipts import SignedReceipt
from node.storage.ledger_view import LedgerView


async def _issue(call: Call) -> web.StreamResponse:
    asked = await call.document(ConsentReceiptRequest)
    issuer = call.services.receipts
    if issuer is None:
        raise BlockRobotError("CONSENT_RECEIPT_ELSEWHERE")
    txid, caller = bytes.fromhex(asked.txid), call.caller

    def issue(snapshot: LedgerView) -> Steps[SignedReceipt]:
        yield
        return issuer.issue(snapshot, txid, caller)

    signed = await call.read(issue)
    return json_answer(
        ConsentReceiptAnswer(
            document=signed.document.decode("ascii"),
            key=signed.key.hex(),
            signature=signed.signature.hex(),
            transaction=signed.transaction.hex(),
        )
    )


ROUTES = (
    Route(
        "POST",
        "/v1/consent-receipts",
        "signConsentReceipt",
        "Sign the receipt of what the caller said about consent, for the organisation that registered them.",
        MEMBER,
        _issue,
        Answer(JSON, ConsentReceiptAnswer, "The receipt and its signature. Asking again gives the same bytes."),
        Body(JSON, ConsentReceiptRequest, "The transaction."),
        errors=(
            "BLOCK_PRUNED",
            "CONSENT_RECEIPT_ELSEWHERE",
            "CONSENT_RECEIPT_INVALID",
            "CONSENT_WORD_MISSING",
            "NOTICE_INVALID",
            "NOT_FOUND",
        ),
    ),
)

"""A bundle's consent receipts, signed twice, matching proved consents."""

from __future__ import annotations

from collections.abc import Sequence

from clients.bundle import documents as doc
from clients.bundle.checks.chain_proofs import ProvedChain
from clients.bundle.checks.consent_receipts import RECEIPTS_MAX_COUNT, CheckedReceipt, check_entry
from clients.bundle.layout import SIGNED_RECEIPTS
from consensus.chain.genesis import Genesis
from consensus.chain.transaction import decode_transaction
from consensus.errors import BlockRobotError
from consensus.state.identity import MemberRow

_REGISTERING = "identity"


def require_owners(checked: CheckedReceipt, row: MemberRow) -> None:
    """Raise CONSENT_RECEIPT_INVALID unless the receipt is this person's, by their registrar; handles outlive key
    rotation.
    """
    if checked.statement.handle != row.handle:
        raise BlockRobotError("CONSENT_RECEIPT_INVALID", "It is of another person.")
    if checked.organisation != row.org:
        raise BlockRobotError(
            "CONSENT_RECEIPT_INVALID", f"{checked.organisation} signed it, and did not register the owner."
        )


def prove_signed(
    chain: ProvedChain, genesis: Genesis, signed: doc.SignedReceipts, row: MemberRow
) -> tuple[CheckedReceipt, ...]:
    """Raises BUNDLE_INVALID (number, order), BUNDLE_UNPROVEN."""
    if not 1 <= len(signed.receipts) <= RECEIPTS_MAX_COUNT:
        raise BlockRobotError("BUNDLE_INVALID", f"{SIGNED_RECEIPTS} has no receipts, or too many.")
    found = []
    for number, entry in enumerate(signed.receipts, 1):
        try:
            checked = check_entry(chain, genesis, entry)
            require_owners(checked, row)
        except BlockRobotError as error:
            raise BlockRobotError("BUNDLE_UNPROVEN", f"Consent receipt {number}: {error.detail}") from None
        found.append(checked)
    places = [(each.statement.height, each.statement.index) for each in found]
    if places != sorted(set(places)):
        raise BlockRobotError("BUNDLE_INVALID", "The consent receipts are not in the order of the chain.")
    return tuple(found)


def require_proved_consents(
    signed: doc.SignedReceipts, found: Sequence[CheckedReceipt], consents: doc.ConsentsDocument
) -> None:
    """Raise BUNDLE_UNPROVEN unless receipts match proved consents or registrations."""
    proved = {(word.transaction, word.kind, word.height) for word in consents.history}
    for number, (entry, checked) in enumerate(zip(signed.receipts, found, strict=True), 1):
        statement = checked.statement
        if not is_registering(entry) and (statement.txid.hex(), statement.status, statement.height) not in proved:
            raise BlockRobotError(
                "BUNDLE_UNPROVEN", f"Consent receipt {number} is of a consent that the bundle does not prove."
            )


def is_registering(entry: doc.ReceiptEntry) -> bool:
    transaction = decode_transaction(doc.read_bytes(SIGNED_RECEIPTS, entry.transaction))
    return transaction.body.contract == _REGISTERING


def build_signed_receipts(signed: doc.SignedReceipts, found: Sequence[CheckedReceipt]) -> doc.SignedReceiptsDocument:
    return doc.SignedReceiptsDocument(
        [_build_receipt(entry, checked) for entry, checked in zip(signed.receipts, found, strict=True)]
    )


def _build_receipt(entry: doc.ReceiptEntry, checked: CheckedReceipt) -> doc.SignedReceiptDocument:
    statement, row = checked.statement, None if checked.published is None else checked.published.row
    return doc.SignedReceiptDocument(
        transaction=statement.txid.hex(),
        status=statement.status,
        height=statement.height,
        time_ms=statement.time_ms,
        organisation=checked.organisation,
        node=checked.node,
        notice_version=0 if row is None else row.version,
        notice_hash="" if row is None else row.digest.hex(),
        controller_key=entry.controller_key,
        controller_signature=entry.controller_signature,
        person_key=statement.member.hex(),
        person_signature=entry.person_signature,
        receipt=checked.fields,
    )

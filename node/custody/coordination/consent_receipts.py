"""Signs receipts of consent statements.

Only final ones of the own organisation, for their author; no consent beyond the notice given.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from consensus.chain.transaction import decode_transaction
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode_value
from consensus.primitives.keys import PrivateKey
from consensus.rights.consent_receipts import (
    ConsentStatement,
    build_document,
    is_notice_of,
    read_statement,
    sign_as_controller,
)
from consensus.rights.notices import (
    PublishedNotice,
    read_published,
    read_row,
    require_consent_asked,
)
from consensus.state.consent import GIVEN, NOTICE, NOTICE_TEXT
from consensus.state.identity import CUSTODIAN, organisation_of
from node.storage.ledger_view import LedgerView, PeersWithBlock, require_not_pruned


@dataclass(frozen=True, slots=True)
class SignedReceipt:
    """A consent receipt signed by the organisation's node, and its transaction's wire."""

    document: bytes
    key: bytes
    signature: bytes
    transaction: bytes


class ConsentReceipts:
    """Receipts of one custodian's organisation, built on demand; none is stored."""

    def __init__(self, key: PrivateKey, peers_with_block: PeersWithBlock = lambda _: ()) -> None:
        self._key = key
        self._keepers = peers_with_block

    def issue(self, snapshot: LedgerView, txid: bytes, caller: bytes) -> SignedReceipt:
        """Raises CONSENT_RECEIPT_ELSEWHERE (other organisation), NOT_FOUND (not final or not theirs), BLOCK_PRUNED,
        CONSENT_WORD_MISSING, NOTICE_INVALID, and as `require_consent_asked`.
        """
        organisation = self._organisation(snapshot, caller)
        place = snapshot.locate(txid)
        if place is not None:
            require_not_pruned(snapshot, place.height, self._keepers)
        block = None if place is None else snapshot.block(place.height)
        receipts = None if place is None else snapshot.receipts(place.height)
        if place is None or block is None or receipts is None:
            raise BlockRobotError("NOT_FOUND", "No final transaction of this id is kept here.")
        transaction = decode_transaction(block.transactions[place.index])
        if transaction.txid != txid or transaction.body.sender != caller:
            raise BlockRobotError("NOT_FOUND", "No final transaction of this id is the caller's.")
        statement = read_statement(
            transaction,
            receipts[place.index],
            height=place.height,
            index=place.index,
            time_ms=block.header.timestamp_ms,
        )
        published = find_notice(snapshot, organisation, statement)
        if statement.status == GIVEN and published is not None:
            require_consent_asked(published, statement.purposes, statement.sensors)
        document = build_document(statement, organisation, published)
        return SignedReceipt(
            document=document,
            key=self._key.public_key,
            signature=sign_as_controller(self._key, document),
            transaction=transaction.wire,
        )

    def _organisation(self, snapshot: LedgerView, caller: bytes) -> str:
        """Raises CONSENT_RECEIPT_ELSEWHERE."""
        custodian = CUSTODIAN.at(snapshot, self._key.public_key)
        if custodian is None or custodian.org != organisation_of(snapshot, caller):
            raise BlockRobotError("CONSENT_RECEIPT_ELSEWHERE")
        return custodian.org


def _value(snapshot: LedgerView, key: bytes) -> Any:
    data = snapshot.get(key)
    return None if data is None else decode_value(data)


def find_notice(snapshot: LedgerView, organisation: str, statement: ConsentStatement) -> PublishedNotice | None:
    """Return the notice in force at a statement, or None. Raises NOTICE_INVALID."""
    row = read_row(organisation, _value(snapshot, NOTICE.key(organisation)))
    following = None
    while row is not None and not is_notice_of(row, following, statement):
        following = row
        row = read_row(organisation, _value(snapshot, NOTICE_TEXT.key(row.version - 1, organisation)))
    if row is None:
        return None
    return read_published(organisation, _value(snapshot, NOTICE_TEXT.key(row.version, organisation)))

"""Receipts of final transactions."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from consensus.api_documents import TransactionEvidence
from consensus.chain.block import ContractEvent, Receipt
from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode_value
from consensus.visible_text import one_entry


@dataclass(frozen=True, slots=True)
class FinalReceipt:
    """A proved outcome; if `ok` is False, `code` says why. `transaction` is present only right after sending."""

    txid: bytes
    height: int
    index: int
    block_id: bytes
    timestamp_ms: int
    ok: bool
    code: str
    message: str
    line: int | None
    gas_used: int
    events: tuple[ContractEvent, ...]
    evidence: TransactionEvidence | None = field(default=None, repr=False, compare=False)
    transaction: Transaction | None = field(default=None, repr=False, compare=False)

    @property
    def sentence(self) -> str:
        return one_entry(f"{self.code}: {self.message}" if self.message else self.code)

    def require_ok(self) -> FinalReceipt:
        """Return the receipt. Raises CALL_REFUSED with the contract's code."""
        if not self.ok:
            raise BlockRobotError("CALL_REFUSED", self.sentence, contract_code=self.code)
        return self

    def event_data(self, contract: str, name: str) -> list[Any]:
        return [decode_value(event.data) for event in self.events if (event.contract, event.name) == (contract, name)]


def final_receipt(
    receipt: Receipt,
    *,
    height: int,
    index: int,
    block_id: bytes,
    timestamp_ms: int,
    evidence: TransactionEvidence | None = None,
) -> FinalReceipt:
    return FinalReceipt(
        txid=receipt.txid,
        height=height,
        index=index,
        block_id=block_id,
        timestamp_ms=timestamp_ms,
        ok=receipt.ok,
        code=receipt.code,
        message=receipt.message,
        line=receipt.line,
        gas_used=receipt.gas_used,
        events=receipt.events,
        evidence=evidence,
    )


def not_final_in_time(txid: bytes) -> BlockRobotError:
    text = f"The transaction {txid.hex()} was not final within the time given."
    return BlockRobotError("TRANSACTION_NOT_FINAL_IN_TIME", text, txid=txid.hex())

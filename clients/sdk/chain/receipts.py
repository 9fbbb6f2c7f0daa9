"""Receipts of final transactions."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from clients.sdk.node_answers import EvidenceDocument
from consensus.chain.block import ContractEvent, Receipt
from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode_value
from consensus.visible_text import one_entry


@dataclass(frozen=True, slots=True)
class FinalReceipt:
    """What became of a transaction, proved final. `ok` is False if the contract refused; then `code` says why.

    `evidence` is what proved it, for who wants to hand the proof on; `transaction` is there for who sent it just now.
    """

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
    evidence: EvidenceDocument | None = field(default=None, repr=False, compare=False)
    transaction: Transaction | None = field(default=None, repr=False, compare=False)

    @property
    def sentence(self) -> str:
        """Return why a call was refused: the code, and the contract's words, whose further lines are marked as such."""
        return one_entry(f"{self.code}: {self.message}" if self.message else self.code)

    def require_ok(self) -> FinalReceipt:
        """Return the receipt itself. Raises CALL_REFUSED with the contract's code if the call failed."""
        if not self.ok:
            raise BlockRobotError("CALL_REFUSED", self.sentence, contract_code=self.code)
        return self

    def event_data(self, contract: str, name: str) -> list[Any]:
        """Return the decoded data of the events of this name, in order."""
        return [decode_value(event.data) for event in self.events if (event.contract, event.name) == (contract, name)]


def final_receipt(
    receipt: Receipt,
    *,
    height: int,
    index: int,
    block_id: bytes,
    timestamp_ms: int,
    evidence: EvidenceDocument | None = None,
) -> FinalReceipt:
    """Join a proved receipt with the place where it was proved to stand."""
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
    """Name the transaction: whoever submitted it wants to look it up."""
    text = f"The transaction {txid.hex()} was not final within the time given."
    return BlockRobotError("TRANSACTION_NOT_FINAL_IN_TIME", text, txid=txid.hex())

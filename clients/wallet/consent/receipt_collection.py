"""Consent receipts for export: kept ones and obtainable ones."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

from clients.bundle import documents as doc
from clients.bundle.checks.chain_proofs import ProvedChain
from clients.bundle.checks.consent_receipts import RECEIPTS_MAX_COUNT, CheckedReceipt, check_entry
from clients.bundle.checks.signed_receipts import require_owners
from clients.bundle.layout import SIGNED_RECEIPTS_MAX_BYTES
from clients.bundle.proving import Heard
from clients.sdk.chain.proved_rows import proved_row
from clients.wallet.consent.receipt_fetching import ConsentReceipts
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.text_catalogue import refusal
from consensus.bounded_text import TextInvalidError, read_json_as
from consensus.errors import BlockRobotError
from consensus.state.identity import MEMBER, MemberRow

FAILING_MAX_S = 20.0
"""How long in all an export asks for receipts that do not come."""
_DOCUMENT_HEAD_BYTES = 1024
_INDENT_BYTES = 4
_Pair = tuple[CheckedReceipt, doc.ReceiptEntry]


@dataclass(frozen=True, slots=True)
class HeldReceipts:
    """Checked receipts in chain order, and what is missing."""

    pairs: tuple[_Pair, ...] = ()
    problems: tuple[doc.Problem, ...] = ()

    def document(self) -> doc.SignedReceipts | None:
        return doc.SignedReceipts([entry for _, entry in self.pairs]) if self.pairs else None


async def collect_receipts(wallet: Wallet, heard: Heard) -> HeldReceipts:
    """None if unregistered."""
    member = wallet.keys.identity
    row = await proved_row(wallet.reading(member), MEMBER, member.public_key)
    if row is None:
        return HeldReceipts()
    collecting = _Collecting(wallet, row)
    await collecting.fetch(heard)
    return collecting.held()


@dataclass
class _Collecting:
    wallet: Wallet
    row: MemberRow
    failures: dict[bytes, BlockRobotError] = field(default_factory=dict)
    problems: list[doc.Problem] = field(default_factory=list)

    def _note(self, code: str, sentence: str) -> None:
        self.problems.append(doc.Problem("", code, sentence))

    def _sound(self) -> tuple[dict[bytes, _Pair], list[BlockRobotError]]:
        found: dict[bytes, _Pair] = {}
        refused = []
        chain = ProvedChain(self.wallet.genesis, ConsentReceipts(self.wallet).epochs())
        for kept in self.wallet.store.content.receipts:
            try:
                entry = read_json_as(kept, doc.ReceiptEntry)
                checked = check_entry(chain, self.wallet.genesis, entry)
                require_owners(checked, self.row)
            except TextInvalidError:
                refused.append(BlockRobotError("CONSENT_RECEIPT_INVALID", "It cannot be read."))
            except BlockRobotError as error:
                refused.append(error)
            else:
                found[checked.statement.txid] = (checked, entry)
        return found, refused

    async def fetch(self, heard: Heard) -> None:
        kept, due = ConsentReceipts(self.wallet), list(self.wallet.store.content.receipts_due)
        known = self._sound()[0]
        wanted = [txid for txid in dict.fromkeys([*due, *await self._find_words(kept)]) if txid not in known]
        failing_s = 0.0
        for number, txid in enumerate(wanted, 1):
            heard("receipts of consent", number, len(wanted))
            began_s = time.monotonic()
            refusal = BlockRobotError("NODE_UNREACHABLE", "It was not asked for: others did not come for too long.")
            if failing_s < FAILING_MAX_S:
                taken = await self._obtain(kept, txid, said_elsewhere=txid not in due)
                if taken is None:
                    continue
                refusal = taken
                failing_s += time.monotonic() - began_s
            if refusal.code == "CONSENT_WORD_MISSING":  # who registered without consenting said nothing of it
                continue
            self.failures[txid] = refusal

    async def _find_words(self, kept: ConsentReceipts) -> list[bytes]:
        try:
            return await kept.find_words()
        except BlockRobotError as error:
            self._note(error.code, f"Which receipts of consent there are could not be read: {error.detail}")
            return []

    async def _obtain(self, kept: ConsentReceipts, txid: bytes, *, said_elsewhere: bool) -> BlockRobotError | None:
        try:
            await kept.obtain(txid, said_elsewhere=said_elsewhere)
        except BlockRobotError as error:
            content = self.wallet.store.content
            if error.code == "CONSENT_WORD_MISSING" and txid in content.receipts_due:
                content.receipts_due.remove(txid)
            return error
        except OSError as error:
            why = error.strerror or type(error).__name__
            return refusal("FILE_UNUSABLE", "wallet_unwritten", why=why)
        return None

    def held(self) -> HeldReceipts:
        found, refused = self._sound()
        for error in refused:
            self._note(
                error.code, f"A receipt of consent that the wallet kept is not sound, and left out: {error.detail}"
            )
        for txid, error in self.failures.items():
            if txid not in found:
                what = f"The receipt signed by both sides of what you said in transaction {txid.hex()[:12]}"
                self._note(error.code, f"{what} could not be had: {error.detail}")
        pairs = sorted(found.values(), key=lambda pair: (pair[0].statement.height, pair[0].statement.index))
        taken = _newest_that_fit(pairs)
        if len(taken) < len(pairs):
            count = len(pairs) - len(taken)
            self._note("EXPORT_TOO_LARGE", f"There are more receipts of consent than a bundle takes: {count} left out.")
        return HeldReceipts(taken, tuple(self.problems))


def _newest_that_fit(pairs: list[_Pair]) -> tuple[_Pair, ...]:
    left = SIGNED_RECEIPTS_MAX_BYTES - _DOCUMENT_HEAD_BYTES
    taken: list[_Pair] = []
    for pair in reversed(pairs):
        content = doc.write_document(pair[1])
        size = len(content) + (1 + content.count(b"\n")) * _INDENT_BYTES
        if size <= left and len(taken) < RECEIPTS_MAX_COUNT:
            left -= size
            taken.append(pair)
    return tuple(reversed(taken))

"""Consent receipts: fetched from own organisation's nodes, checked, countersigned, kept."""

from __future__ import annotations

import asyncio
import time
from dataclasses import dataclass

import msgspec

from clients.bundle.checks.chain_proofs import ProvedChain
from clients.bundle.checks.consent_receipts import CheckedReceipt, check_entry, read_reference, state_keys
from clients.bundle.documents import ReceiptEntry
from clients.sdk.chain.contract_events import each_event
from clients.sdk.chain.proved_rows import proved_row
from clients.sdk.connections import NodeAddress
from clients.sdk.node_answers import read_answer, read_hex
from clients.wallet.ledger.proof_collection import StateCollector
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.store.kept_proofs import receipt_proof
from clients.wallet.text_catalogue import refusal
from consensus.api_documents import ConsentReceiptAnswer, ConsentReceiptRequest
from consensus.bounded_text import TextInvalidError, read_json_as
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode
from consensus.rights.consent_receipts import sign_as_person
from consensus.rights.notices import require_consent_asked
from consensus.state.consent import CONSENT, GIVEN
from consensus.state.identity import MEMBER

ASK_PAUSE_S = 0.25
ASK_PASSES_COUNT = 12
ASK_MAX_S = 10.0
ASK_NODE_MAX_S = 3.0
_MAY_COME = frozenset({"NOT_FOUND", "NODE_UNREACHABLE"})


@dataclass(frozen=True, slots=True)
class Receipts:
    """Receipts in chain order, and errors of missing ones by transaction."""

    checked: tuple[CheckedReceipt, ...]
    entries: tuple[ReceiptEntry, ...]
    missing: tuple[tuple[bytes, BlockRobotError], ...]


class ConsentReceipts:
    """Consent receipts of the wallet's owner."""

    def __init__(self, wallet: Wallet) -> None:
        self._wallet = wallet

    async def obtain(self, txid: bytes, *, said_elsewhere: bool = False) -> CheckedReceipt:
        """Fetch, check, countersign and keep a receipt; pending until done.

        `said_elsewhere`: by another wallet copy. Raises CONSENT_RECEIPT_INVALID, CONSENT_RECEIPT_ELSEWHERE, as
        `require_consent_asked`.
        """
        content = self._wallet.store.content
        if txid not in content.receipts_due:
            content.receipts_due.append(txid)
            self._wallet.store.save()
        entry = await self._fetch(txid)
        checked = self._check(entry, signed=False)
        await self._require_own(checked, txid)
        if checked.statement.status == GIVEN and checked.published is not None:
            require_consent_asked(checked.published, checked.statement.purposes, checked.statement.sensors)
        document, signature = entry.document.encode(), bytes.fromhex(entry.controller_signature)
        own = sign_as_person(self._wallet.keys.identity, document, signature)
        entry = msgspec.structs.replace(entry, person_signature=own.hex())
        self._check(entry, signed=True)
        content.receipts.append(msgspec.json.encode(entry))
        if txid in content.receipts_due:  # two tasks of the wallet's page may have asked for it
            content.receipts_due.remove(txid)
        if checked.statement.status == GIVEN and checked.published is not None:
            version = checked.published.row.version
            if not said_elsewhere:
                version = min(version, content.notice_shown_version)
            content.notice_consented_version = max(content.notice_consented_version, version)
        self._wallet.store.save()
        return checked

    def _check(self, entry: ReceiptEntry, *, signed: bool) -> CheckedReceipt:
        genesis = self._wallet.genesis
        return check_entry(ProvedChain(genesis, self.epochs()), genesis, entry, signed=signed)

    async def _require_own(self, checked: CheckedReceipt, txid: bytes) -> None:
        """Raises CONSENT_RECEIPT_INVALID."""
        statement, member = checked.statement, self._wallet.keys.identity
        if statement.txid != txid or statement.member != member.public_key:
            raise BlockRobotError("CONSENT_RECEIPT_INVALID", "It is of another word, or of another person.")
        row = await proved_row(self._wallet.reading(member), MEMBER, member.public_key)
        if row is None or statement.handle != row.handle or checked.organisation != row.org:
            raise BlockRobotError("CONSENT_RECEIPT_INVALID", "It is not by the organisation that registered you.")

    async def _fetch(self, txid: bytes) -> ReceiptEntry:
        wallet = self._wallet
        answer = await self._ask(txid)
        member, network = wallet.keys.identity, wallet.network
        receipt = await network.wait_final(txid, lane=member.public_key)
        if receipt.evidence is None:
            raise BlockRobotError("PROOF_INVALID", "The node proved nothing of the word.")
        organisation, version = read_reference(answer.document.encode())
        collector = StateCollector(wallet, member)
        await collector.read(state_keys(read_hex(answer.key), member.public_key, organisation, version))
        return ReceiptEntry(
            document=answer.document,
            controller_key=answer.key,
            controller_signature=answer.signature,
            person_signature="",
            transaction=answer.transaction,
            proof=receipt_proof(receipt, receipt.evidence),
            state=collector.document(),
        )

    async def _ask(self, txid: bytes) -> ConsentReceiptAnswer:
        """Custodians in turn, three seconds each, ten in all; raises the last refusal."""
        over_at = time.monotonic() + ASK_MAX_S
        failure = BlockRobotError("CONSENT_RECEIPT_ELSEWHERE", "No custodian of the network could be asked.")
        for left in reversed(range(ASK_PASSES_COUNT)):
            may_come = False
            for node in self._wallet.network.custody.custodians:
                left_s = over_at - time.monotonic()
                if left_s <= 0:
                    raise failure
                try:
                    return await self._ask_node_for(node, txid, min(ASK_NODE_MAX_S, left_s))
                except BlockRobotError as error:
                    if error.code != "CONSENT_RECEIPT_ELSEWHERE" or failure.code == error.code:
                        failure = error
                    may_come = may_come or error.entry.retryable or error.code in _MAY_COME
            if not may_come or not left:
                break
            await asyncio.sleep(ASK_PAUSE_S)
        raise failure

    async def _ask_node_for(self, node: NodeAddress, txid: bytes, longest_s: float) -> ConsentReceiptAnswer:
        try:
            async with asyncio.timeout(longest_s):
                return await self._ask_node(node, txid)
        except TimeoutError:
            detail = f"The custodian {node.name} did not answer in time."
            raise BlockRobotError("NODE_UNREACHABLE", detail) from None

    async def _ask_node(self, node: NodeAddress, txid: bytes) -> ConsentReceiptAnswer:
        body = msgspec.json.encode(ConsentReceiptRequest(txid.hex()))
        key = self._wallet.keys.identity
        content = await self._wallet.network.ask_node(node, "POST", "/v1/consent-receipts", key=key, body=body)
        return read_answer(content, ConsentReceiptAnswer)

    def epochs(self) -> list[str]:
        return [encode(proof).hex() for proof in self._wallet.network.light_client.epochs]

    async def all(self, *, search: bool = False) -> Receipts:
        """Return all receipts, rechecked; fetch pending ones, with `search` all on chain. Raises
        CONSENT_RECEIPT_INVALID, NOT_REGISTERED.
        """
        await self._wallet.require_registered()
        content = self._wallet.store.content
        elsewhere = set()
        if search:
            known = {self._check(each, signed=True).statement.txid for each in self._kept()}
            for txid in await self.find_words():
                if txid not in known and txid not in content.receipts_due:
                    content.receipts_due.append(txid)
                    elsewhere.add(txid)
        missing = []
        for txid in list(content.receipts_due):
            try:
                await self.obtain(txid, said_elsewhere=txid in elsewhere)
            except BlockRobotError as error:
                if error.code == "CONSENT_WORD_MISSING":
                    content.receipts_due.remove(txid)
                    continue
                missing.append((txid, error))
        kept = [(self._check(entry, signed=True), entry) for entry in self._kept()]
        pairs = list({pair[0].statement.txid: pair for pair in kept}.values())  # a file with one twice is refused
        pairs.sort(key=lambda pair: (pair[0].statement.height, pair[0].statement.index))
        checked, entries = tuple(pair[0] for pair in pairs), tuple(pair[1] for pair in pairs)
        return Receipts(checked, entries, tuple(missing))

    def _kept(self) -> list[ReceiptEntry]:
        try:
            return [read_json_as(each, ReceiptEntry) for each in self._wallet.store.content.receipts]
        except TextInvalidError:
            raise BlockRobotError("CONSENT_RECEIPT_INVALID", "A kept receipt was written by another version.") from None

    async def find_words(self) -> list[bytes]:
        """This key's registration and consent transactions, oldest first."""
        member = self._wallet.keys.identity
        found: dict[bytes, int] = {}
        for contract, names in (("identity", ("registered",)), (CONSENT, ("given", "refused", "withdrawn"))):
            async for event in each_event(self._wallet.network, member, contract=contract):
                own = isinstance(event.data, dict) and event.data.get("member") == member.public_key
                if own and event.name in names and not event.data.get("mandate"):
                    found[event.txid] = event.place.height
        return sorted(found, key=lambda txid: found[txid])


@dataclass(frozen=True, slots=True)
class ReceiptOutcome:
    """A statement's receipt, or why it is missing."""

    receipt: CheckedReceipt | None
    refusal: BlockRobotError | None

    @property
    def error_code(self) -> str | None:
        return None if self.receipt is not None or self.refusal is None else self.refusal.code


async def try_fetch_receipt(opened: Wallet, txid: bytes) -> ReceiptOutcome:
    """Return a failure rather than raise it."""
    try:
        return ReceiptOutcome(await ConsentReceipts(opened).obtain(txid), None)
    except BlockRobotError as error:
        return ReceiptOutcome(None, error)
    except OSError as error:
        why = error.strerror or type(error).__name__
        return ReceiptOutcome(None, refusal("FILE_UNUSABLE", "wallet_unwritten", why=why))

"""Collect transferable proofs, each visit in its owner key's session, the person in the member key's."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from clients.bundle import document_building
from clients.bundle import documents as doc
from clients.bundle.checks import visit_check
from clients.bundle.checks.chain_proofs import ProvedChain
from clients.bundle.checks.consent_receipts import CheckedReceipt
from clients.bundle.checks.key_history import CONTRACT, REGISTERED, ROTATED, own_steps, read_step
from clients.bundle.checks.signed_receipts import is_registering
from clients.sdk.chain.contract_events import each_event
from clients.sdk.connections import NodeAddress
from clients.sdk.network_client import NetworkClient
from clients.sdk.node_answers import read_answer, read_hex
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.store.kept_proofs import KeptProof, finality_bytes, kept_of, receipt_proof
from clients.wallet.store.keystore import KnownVisit
from consensus.api_documents import PROOF_KEYS_MAX_COUNT, BlockAnswer
from consensus.chain.block import Block, FinalityProof, Header
from consensus.chain.transaction import Transaction, decode_transaction
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import decode, encode
from consensus.primitives.keys import PrivateKey
from consensus.state.audit import COUNT, ENTRY, entry_keys
from consensus.state.consent import CHOICES, CONSENT, LAST_STATEMENT_HEIGHT
from consensus.state.identity import MEMBER
from consensus.state.rights import CORRECTION_COUNT, correction_keys

Signed = Sequence[tuple[CheckedReceipt, doc.ReceiptEntry]]
"""Consent receipts that were checked, each with what proves it."""


@dataclass
class StateCollector:
    """Proofs of one session, and their values."""

    wallet: Wallet
    key: PrivateKey
    values: dict[bytes, Any] = field(default_factory=dict)
    _found: dict[bytes, tuple[bytes, doc.KeyProof]] = field(default_factory=dict)

    async def read(self, keys: Sequence[bytes]) -> None:
        fresh = [key for key in dict.fromkeys(keys) if key not in self.values]
        for start in range(0, len(fresh), PROOF_KEYS_MAX_COUNT):
            part = fresh[start : start + PROOF_KEYS_MAX_COUNT]
            state = await self.wallet.network.state_values(part, self.key)
            if state.answer is None or state.answer.finality is None:
                raise BlockRobotError("PROOF_INVALID", "The node proved this by genesis alone.")
            finality = finality_bytes(state.answer.finality)
            for key, proof in zip(part, state.answer.proofs, strict=True):
                value = None if proof.value is None else read_hex(proof.value).hex()
                self._found[key] = (finality, doc.KeyProof(key.hex(), value, read_hex(proof.proof).hex()))
            self.values.update(state.values)

    def leave_out(self, key: bytes) -> None:
        del self._found[key]
        del self.values[key]

    def document(self) -> doc.StateProofs:
        by_block: dict[bytes, list[doc.KeyProof]] = {}
        for _, (finality, proof) in sorted(self._found.items()):
            by_block.setdefault(finality, []).append(proof)
        ordered = sorted(by_block.items(), key=lambda pair: (_height_of(pair[0]), pair[0]))
        return doc.StateProofs([doc.Snapshot(finality.hex(), proofs) for finality, proofs in ordered])


def _height_of(finality: bytes) -> int:
    return decode(decode(finality, FinalityProof).header_bytes, Header).height


@dataclass(frozen=True, slots=True)
class VisitProofs:
    """A visit's proofs and values."""

    document: doc.StateProofs
    values: dict[bytes, Any]


async def collect_visit(wallet: Wallet, visit: KnownVisit, chosen: frozenset[bytes] | None) -> VisitProofs:
    collector = StateCollector(wallet, wallet.owner_key(visit))
    await collector.read(visit_check.trail_keys(visit.owner))
    count = COUNT.among(collector.values, visit.owner) or 0
    corrections = CORRECTION_COUNT.among(collector.values, visit.owner) or 0
    await collector.read(correction_keys(visit.owner, corrections))
    await collector.read(entry_keys(visit.owner, count))
    due: list[bytes] = []
    for key in entry_keys(visit.owner, count):
        entry = ENTRY.convert(collector.values[key])
        if chosen is not None and entry.record_id and entry.record_id not in chosen:
            collector.leave_out(key)
            continue
        due += visit_check.keys_of_entry(entry)
    await collector.read(due)
    return VisitProofs(collector.document(), collector.values)


@dataclass(frozen=True, slots=True)
class PersonProofs:
    """Proofs of identity and statements; `sealing` are keys robots sealed to, proved by `keys`."""

    state: doc.StateProofs | None
    receipts: tuple[doc.ReceiptProof, ...]
    problems: tuple[doc.Problem, ...]
    sealing: tuple[bytes, ...] = ()
    keys: doc.KeyHistory | None = None


async def collect_person(wallet: Wallet, signed: Signed = ()) -> PersonProofs:
    """Raises NOT_REGISTERED."""
    await wallet.require_registered()
    member = wallet.keys.identity
    collector = StateCollector(wallet, member)
    await collector.read([MEMBER.key(member.public_key)])
    row = MEMBER.among(collector.values, member.public_key)
    if row is None:
        raise BlockRobotError("NOT_REGISTERED")
    await collector.read([CHOICES.key(row.handle), LAST_STATEMENT_HEIGHT.key(row.handle)])
    receipts, problems = await _collect_words(wallet, member, signed)
    sealing, keys = [row.sealing], None
    if len(wallet.eras) > 1:
        sealing, keys, more = await _collect_keys(wallet, row.sealing)
        problems += more
    return PersonProofs(collector.document(), tuple(receipts), tuple(problems), tuple(sealing), keys)


async def _collect_keys(wallet: Wallet, present: bytes) -> tuple[list[bytes], doc.KeyHistory | None, list[doc.Problem]]:
    member = wallet.keys.identity
    steps: list[doc.KeyChange] = []
    sealing: list[bytes] = []
    problems: list[doc.Problem] = []
    kept = await _kept_of(wallet, CONTRACT)
    try:
        events = [*map(_event_of_step, kept.items()), *await _identity_events(wallet, member)]
        for txid in reversed(own_steps(events, member.public_key)):
            step = await _key_change(wallet, member, txid, kept)
            sealing.insert(0, read_step(_transaction_of(step)).sealing)
            steps.insert(0, step)
    except BlockRobotError as error:
        sentence = f"How you came to your former keys could not be read whole, so some is your own word: {error.detail}"
        problems.append(doc.Problem("", error.code, sentence))
    return sealing or [present], doc.KeyHistory(steps) if steps else None, problems


async def _key_change(
    wallet: Wallet, member: PrivateKey, txid: bytes, kept: Mapping[bytes, KeptProof]
) -> doc.KeyChange:
    if txid in kept:
        return doc.KeyChange(kept[txid].transaction, kept[txid].proof)
    receipt = await wallet.network.wait_final(txid, lane=member.public_key)
    if receipt.evidence is None:
        raise BlockRobotError("PROOF_INVALID", "The node proved nothing of it.")
    transaction = await read_transaction(wallet.network, member, receipt.height, txid)
    return doc.KeyChange(transaction.wire.hex(), receipt_proof(receipt, receipt.evidence))


def _transaction_of(step: doc.KeyChange | KeptProof) -> Transaction:
    return decode_transaction(doc.read_bytes("a kept proof", step.transaction))


def _event_of_step(kept: tuple[bytes, KeptProof]) -> tuple[bytes, str, dict[str, Any]]:
    step = read_step(_transaction_of(kept[1]))
    if not step.before:
        return kept[0], REGISTERED, {"member": step.member}
    return kept[0], ROTATED, {"member": step.before, "new_member": step.member}


async def _kept_of(wallet: Wallet, contract: str) -> dict[bytes, KeptProof]:
    epochs, proofs = list(wallet.network.light_client.epochs), dict(wallet.store.content.proofs)

    def check() -> dict[bytes, KeptProof]:
        chain = ProvedChain(wallet.genesis, [encode(proof).hex() for proof in epochs])
        return dict(kept_of(proofs, chain, wallet.genesis.chain_id, contract))

    return await asyncio.to_thread(check)


async def _identity_events(wallet: Wallet, member: PrivateKey) -> list[tuple[bytes, str, dict[str, Any]]]:
    found: list[tuple[bytes, str, dict[str, Any]]] = []
    for name in (REGISTERED, ROTATED):
        async for event in each_event(wallet.network, member, contract=CONTRACT, name=name):
            found += [(event.txid, event.name, event.data)] if event.name == name else []
    return found


async def _collect_words(
    wallet: Wallet, member: PrivateKey, signed: Signed
) -> tuple[list[doc.ReceiptProof], list[doc.Problem]]:
    """Consent statements, with proofs: of the signed receipt, else kept, else fetched."""
    words: dict[bytes, int] = {}
    problems: list[doc.Problem] = []
    try:
        async for event in each_event(wallet.network, member, contract=CONSENT):
            own = isinstance(event.data, dict) and event.data.get("member") == member.public_key
            own = own and not event.data.get("mandate")  # said for another person
            if own and event.name in document_building.WORDS:
                words[event.txid] = event.place.height
    except BlockRobotError as error:
        problems.append(doc.Problem("", error.code, f"The history of your consents could not be read: {error.detail}"))
    found: list[tuple[int, int, doc.ReceiptProof]] = [
        (each.statement.height, each.statement.index, entry.proof)
        for each, entry in signed
        if not is_registering(entry)
    ]
    held = {each.statement.txid for each, _ in signed}
    for txid, kept in (await _kept_of(wallet, CONSENT)).items():
        if txid not in held and _transaction_of(kept).body.sender == member.public_key:
            held.add(txid)
            found.append((decode(bytes.fromhex(kept.proof.headers[0]), Header).height, kept.proof.index, kept.proof))
    for txid, height in words.items():
        if txid in held:
            continue
        try:
            receipt = await wallet.network.wait_final(txid, lane=member.public_key)
        except BlockRobotError as error:
            sentence = f"The receipt of what you said on consent in block {height} could not be had: {error.detail}"
            problems.append(doc.Problem("", error.code, sentence))
            continue
        if receipt.evidence is not None:
            found.append((receipt.height, receipt.index, receipt_proof(receipt, receipt.evidence)))
    found.sort(key=lambda each: each[:2])
    return [proof for _, _, proof in found], problems


async def read_transaction(client: NetworkClient, key: PrivateKey, height: int, txid: bytes) -> Transaction:
    """From its block, in a member's session; checked only by id. Raises PROOF_INVALID, BLOCK_PRUNED."""

    async def ask(node: NodeAddress) -> Transaction:
        content = await client.ask_node(node, "GET", f"/v1/blocks/{height}", key=key)
        for wire in decode(read_hex(read_answer(content, BlockAnswer).block), Block).transactions:
            transaction = decode_transaction(wire)
            if transaction.txid == txid:
                return transaction
        raise BlockRobotError("PROOF_INVALID", f"Block {height} of the node does not hold the transaction.")

    return await client.with_any_node(ask)

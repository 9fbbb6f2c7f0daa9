"""A ward whose custodians sign consent receipts and whose nodes prove notices: the node's own code behind a short wire."""

from __future__ import annotations

import json
from collections.abc import Awaitable, Callable, Sequence
from types import SimpleNamespace
from typing import Any

import msgspec

from clients.bundle import documents as doc
from clients.bundle.checks.consent_receipts import read_reference, state_keys
from clients.sdk.connections import NodeAddress
from clients.sdk.node_answers import read_answer
from clients.sdk.proof_checks import ProvedState
from clients.wallet.ledger.proof_collection import StateCollector
from clients.wallet.store.kept_proofs import receipt_proof
from consensus.api_documents import ConsentReceiptAnswer, ProofsAnswer
from consensus.primitives.keys import PrivateKey
from consensus.rights.consent_receipts import sign_as_person
from consensus.rights.notices import Notice, encode_notice
from node.api.routes.notices import PUBLIC_PREFIXES
from node.custody.coordination.consent_receipts import ConsentReceipts, SignedReceipt
from tests.world.ward import ProvingHospital, ShortWire, Ward


class Ledger:
    """The hospital's chain as a node's snapshot shows it."""

    def __init__(self, chain: ProvingHospital) -> None:
        self._chain = chain
        self.earliest_height = 0

    @property
    def header(self) -> Any:
        return self._chain.head

    @property
    def finality(self) -> Any:
        return self._chain.finality()

    def get(self, key: bytes) -> bytes | None:
        return self._chain.state.get(key)

    def locate(self, txid: bytes) -> Any:
        for height, receipts in enumerate(self._chain.receipts, 1):
            for index, receipt in enumerate(receipts):
                if receipt.txid == txid:
                    return SimpleNamespace(height=height, index=index)
        return None

    def block(self, height: int) -> Any:
        return self._chain.blocks[height - 1]

    def receipts(self, height: int) -> Any:
        return self._chain.receipts[height - 1]


class NoticeWire(ShortWire):
    """A short wire that also answers for notices and receipts. `forge` may change what a node signs."""

    def __init__(self, chain: ProvingHospital) -> None:
        super().__init__(chain)
        self.ledger: Any = Ledger(chain)
        self.issuer = ConsentReceipts(chain.custodians[0])
        self.forge: Callable[[SignedReceipt], SignedReceipt] = lambda signed: signed
        self.public_keys: list[bytes] = []

    async def prove_public(
        self, asking: Callable[[NodeAddress], Awaitable[bytes]], keys: Sequence[bytes]
    ) -> ProvedState:
        return self.trust.values(read_answer(await asking(self.nodes[0]), ProofsAnswer), keys)

    async def ask_node(self, node: NodeAddress, method: str, path: str, **given: Any) -> bytes:
        if path == "/v1/notice-proofs":
            keys = [bytes.fromhex(key) for key in json.loads(given["body"])["keys"]]
            assert "key" not in given, "nobody's session"
            assert all(key.startswith(PUBLIC_PREFIXES) for key in keys)
            self.public_keys += keys
            return msgspec.json.encode(self._answer(keys))
        if path == "/v1/consent-receipts":
            txid = bytes.fromhex(json.loads(given["body"])["txid"])
            signed = self.forge(self.issuer.issue(self.ledger, txid, given["key"].public_key))
            return msgspec.json.encode(
                ConsentReceiptAnswer(
                    signed.document.decode(), signed.key.hex(), signed.signature.hex(), signed.transaction.hex()
                )
            )
        return await super().ask_node(node, method, path, **given)


class NoticeWard(Ward):
    """The ward with such a wire."""

    network: NoticeWire

    def make_wire(self) -> NoticeWire:
        return NoticeWire(self.chain)

    def publish(self, notice: Notice) -> None:
        self.chain.must(self.chain.admin, "consent", "publish_notice", encode_notice(notice))


async def entry_of(ward: NoticeWard, key: PrivateKey, txid: bytes) -> doc.ReceiptEntry:
    """The receipt of anybody's word, as her own wallet would have it."""
    issued = ward.network.issuer.issue(ward.network.ledger, txid, key.public_key)
    final = await ward.network.wait_final(txid)
    collector = StateCollector(ward.wallet, key)
    await collector.read(state_keys(issued.key, key.public_key, *read_reference(issued.document)))
    assert final.evidence is not None
    return doc.ReceiptEntry(
        document=issued.document.decode(),
        controller_key=issued.key.hex(),
        controller_signature=issued.signature.hex(),
        person_signature=sign_as_person(key, issued.document, issued.signature).hex(),
        transaction=issued.transaction.hex(),
        proof=receipt_proof(final, final.evidence),
        state=collector.document(),
    )

"""A ward on a small chain that proves: real contracts, real headers and certificates, real wallet; only the wire is short.

The chain is the hospital's of the contract tests; every block gets a header and the votes of its producers, so that a
client that trusts the genesis file alone can follow. Custodians are dicts.
"""

from __future__ import annotations

import json
import secrets
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, TypeVar

import msgspec
import numpy as np

from clients.robot.recording.sealing import ClipContent, VisitChain, seal_clip
from clients.sdk.chain.announcements import AnnouncementPage, read_announcements
from clients.sdk.chain.receipts import FinalReceipt
from clients.sdk.connections import NodeAddress
from clients.sdk.known_nodes import nodes_of_genesis
from clients.sdk.pictures.rendition_picture import encode_depth_png
from clients.sdk.proof_checks import ProofVerifier, ProvedState
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.store.keystore import Keystore
from clients.wallet.store.member_keys import WalletKeys, draw_words
from consensus.api_documents import BlockAnswer, BlockSummary, KeyProof, ProofsAnswer, describe, finality_document
from consensus.chain.block import (
    Block,
    FinalityProof,
    Header,
    IndexedSignature,
    QuorumCertificate,
    Receipt,
    compute_receipts_root,
    compute_transactions_root,
    genesis_certificate,
)
from consensus.chain.light_client import LightClient
from consensus.chain.messages import VOTE_TAG, vote_parts
from consensus.chain.transaction import Transaction, decode_transaction
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.records.clips import ClipDownload, FrameDownload
from consensus.records.commitments import ciphertext_leaves
from consensus.records.owner_keys import open_visit_keys
from consensus.records.renditions import Rendition
from consensus.state.audit import ENTRY
from consensus.state.records import ANNOUNCEMENT, ANNOUNCEMENT_COUNT
from node.api.access.metering import Steps
from node.api.evidence import build_evidence
from node.storage.ledger_view import TransactionPlace
from tests.unit.contracts.privacy.hospital import Hospital, Person, key_of
from tests.world.dicts import CHEAP

WIDTH, HEIGHT = 32, 24


@dataclass
class Patient(Person):
    """Somebody whose keys are a wallet's."""

    keys: WalletKeys | None = None

    @property
    def identity(self) -> PrivateKey:
        assert self.keys
        return self.keys.identity

    @property
    def spend(self) -> PrivateKey:
        assert self.keys
        return self.keys.spend

    @property
    def view(self) -> PrivateKey:
        assert self.keys
        return self.keys.view

    @property
    def sealing(self) -> bytes:
        assert self.keys
        return self.keys.sealing_public


T = TypeVar("T")


class ProvingHospital(Hospital):
    """The hospital's chain, with headers and certificates."""

    def __init__(self) -> None:
        self.headers: list[Header] = []
        self.blocks: list[Block] = []
        self.receipts: list[tuple[Receipt, ...]] = []
        super().__init__()

    def qc(self, header: Header) -> QuorumCertificate:
        if header.height == 0:
            return genesis_certificate(self.genesis.block_id)
        block_id = sha256(encode(header))
        parts = vote_parts(self.chain_id, 0, header.round, block_id)
        keys = [key_of(f"{name}/producer") for name in self.custodian_names]
        votes = tuple(IndexedSignature(place, key.sign_compact(VOTE_TAG, *parts)) for place, key in enumerate(keys))
        return QuorumCertificate(0, header.round, block_id, votes)

    def _header(self, parent: Header, **changes: Any) -> Header:
        fields = {
            "version": parent.version,
            "chain_id": self.chain_id,
            "epoch": 0,
            "height": parent.height + 1,
            "round": parent.round + 1,
            "parent_id": sha256(encode(parent)),
            "qc": self.qc(parent),
            "tc": None,
            "producer": (parent.round + 1) % len(self.custodian_names),
            "timestamp_ms": self.time_ms,
            "transactions_root": compute_transactions_root([]),
            "receipts_root": compute_receipts_root(()),
            "state_root": self.state.state_root,
            "next_schedule_hash": None,
            "gas_used": 0,
        }
        return Header(**(fields | changes))

    @property
    def head(self) -> Header:
        return self.headers[-1] if self.headers else self.genesis.block().header

    def block(self, transactions: list[Transaction]) -> list[Receipt]:
        parent = self.head
        receipts = super().block(transactions)
        header = self._header(
            parent,
            transactions_root=compute_transactions_root([receipt.txid for receipt in receipts]),
            receipts_root=compute_receipts_root(tuple(receipts)),
        )
        self.headers.append(header)
        self.blocks.append(Block(encode(header), b"", tuple(each.wire for each in transactions)))
        self.receipts.append(tuple(receipts))
        return receipts

    def finality(self) -> FinalityProof:
        """The proof of the newest block, by the child that would come next."""
        child = self._header(self.head)
        return FinalityProof(encode(self.head), encode(child), self.qc(child))

    def snapshot(self) -> Any:
        """What evidence of a receipt is built from."""
        return SimpleNamespace(
            header=self.head,
            finality=self.finality(),
            header_bytes=lambda height: self.blocks[height - 1].header_bytes if self._has(height) else None,
            receipt_bytes=lambda height: (
                [(each.txid, encode(each)) for each in self.receipts[height - 1]] if self._has(height) else None
            ),
        )

    def _has(self, height: int) -> bool:
        return 0 < height <= len(self.blocks)


def read_at_once(steps: Steps[T]) -> T:
    """Return what pausing work comes to."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            result: T = end.value
            return result


class ShortWire:
    """The wallet's network: asks the chain in memory, and checks every answer as the real client does."""

    pinned = b"pinned"

    def __init__(self, chain: ProvingHospital) -> None:
        self.chain = chain
        self.light_client = LightClient(chain.genesis)
        self.trust = ProofVerifier(chain.genesis, self.light_client)
        self.custody = Custodians()
        self.asked: list[tuple[bytes, bytes]] = []
        self.before_proofs: Callable[[], None] | None = None
        self.pruned_height = 0
        self.pruned_below = 0
        self.genesis = chain.genesis
        self.known_custodians = nodes_of_genesis(chain.genesis).custodians
        self.nodes: tuple[NodeAddress, ...] = (NodeAddress("node-1", "http://127.0.0.1:2"),)
        self.troubles: dict[str, BlockRobotError] = {}
        self.page_count, self.pages = 200, 0

    async def close(self) -> None:
        """Nothing is open."""

    def _answer(self, keys: Sequence[bytes]) -> ProofsAnswer:
        proofs = []
        for key in keys:
            value = self.chain.state.get(key)
            proof = encode(self.chain.state.prove(key)).hex()
            proofs.append(KeyProof(key.hex(), None if value is None else value.hex(), proof))
        return ProofsAnswer(finality_document(self.chain.finality()), proofs)

    async def state_values(self, keys: Sequence[bytes], key: PrivateKey) -> ProvedState:
        self.asked.extend((flat, key.public_key) for flat in keys)
        if self.before_proofs and any(map(ENTRY.owns, keys)):
            self.before_proofs()
        return self.trust.values(self._answer(keys), keys)

    async def newest_header(self, key: PrivateKey) -> Header:
        return self.chain.head

    async def announcements(self, first: int, key: PrivateKey, limit: int = 0) -> AnnouncementPage:
        self.pages += 1
        end = min(ANNOUNCEMENT_COUNT.read(self.chain.state) or 0, first + (limit or self.page_count))
        keys = [ANNOUNCEMENT_COUNT.flat, *map(ANNOUNCEMENT.key, range(first, end))]
        return read_announcements(self.trust, self._answer(keys), first, max(1, end - first))

    async def call(self, key: PrivateKey, contract: str, entry: str, arguments: list[Any]) -> FinalReceipt:
        receipt = self.chain.send(key, contract, entry, *arguments)
        if not receipt.ok:
            told = f"{receipt.code}: {receipt.message}"
            raise BlockRobotError("CALL_REFUSED", told, contract_code=receipt.code)
        final = await self.wait_final(receipt.txid)
        wire = self.chain.blocks[final.height - 1].transactions[final.index]
        return replace(final, transaction=decode_transaction(wire))

    async def wait_final(self, txid: bytes, timeout_ms: int = 0, *, lane: bytes = b"") -> FinalReceipt:
        for height, receipts in enumerate(self.chain.receipts, 1):
            for index, receipt in enumerate(receipts):
                if receipt.txid == txid:
                    if height < self.pruned_below:
                        raise BlockRobotError("BLOCK_PRUNED")
                    evidence = read_at_once(build_evidence(self.chain.snapshot(), TransactionPlace(height, index)))
                    return self.trust.receipt(evidence, txid, index)
        raise BlockRobotError("TRANSACTION_EXPIRED")

    async def find_nodes(self, key: PrivateKey) -> None:
        """All are known."""

    async def with_any_node(self, work: Callable[[NodeAddress], Awaitable[Any]]) -> Any:
        return await work(self.nodes[0])

    async def ask_node(self, node: NodeAddress, method: str, path: str, **given: Any) -> bytes:
        """A block, or the page of events: all of a contract, from a place on."""
        if path.startswith("/v1/blocks/"):
            height = int(path.rsplit("/", 1)[1])
            if height == self.pruned_height or height < self.pruned_below:
                raise BlockRobotError("BLOCK_PRUNED")
            return answer_block(self.chain.blocks[height - 1])
        if path == "/v1/consent-receipts":  # a wire that signs them is in notices.py
            raise BlockRobotError("CONSENT_WORD_MISSING")
        assert (method, path) == ("GET", "/v1/events/page")
        wanted = given["query"]
        first = tuple(map(int, wanted.get("from", "0:0").split(":")))
        rows = []
        for height, receipts in enumerate(self.chain.receipts, 1):
            events = [(receipt, event) for receipt in receipts for event in receipt.events]
            for index, (receipt, event) in enumerate(events):
                if event.contract == wanted["contract"] and (height, index) >= max(first, (self.pruned_below, 0)):
                    row = {"place": f"{height}:{index}", "contract": event.contract, "name": event.name}
                    rows.append({**row, "data": event.data.hex(), "txid": receipt.txid.hex()})
        head = len(self.chain.receipts)
        after = {"head": head, "earliest_height": 0, "next": f"{head + 1}:0", "events": rows}
        return json.dumps(after).encode()


def answer_block(block: Block) -> bytes:
    """What a node answers for a block, without what is in its receipts."""
    summary = describe(
        BlockSummary, block.header, block_id=block.block_id.hex(), transaction_count=len(block.transactions)
    )
    return msgspec.json.encode(BlockAnswer(summary, encode(block).hex(), txids=[], receipts=[]))


class Custodians:
    """Two custodians that have everything, unless they are away."""

    def __init__(self) -> None:
        self.clips: dict[bytes, ClipDownload] = {}
        self.rooms: dict[bytes, bytes] = {}
        self.refusals: dict[bytes, str] = {}
        self.custodians = tuple(NodeAddress(f"node-{number}", "http://127.0.0.1:2") for number in (1, 2))

    def keepers_first(self, _record_id: bytes) -> tuple[NodeAddress, ...]:
        return self.custodians

    async def download_clip(
        self, node: NodeAddress, record_id: bytes, access_id: bytes, key: PrivateKey
    ) -> ClipDownload:
        if record_id in self.refusals:
            raise BlockRobotError(self.refusals[record_id])
        return self.clips[record_id]

    async def find_background(
        self, digest: bytes, key: PrivateKey, missing: dict[bytes, BlockRobotError]
    ) -> bytes | None:
        if digest not in self.rooms:
            missing[digest] = BlockRobotError("EMPTY_FRAME_WITHDRAWN")
        return self.rooms.get(digest)


class Ward:
    """A registered patient with her wallet, a robot that records her, two custodians."""

    def __init__(self, folder: Path, hospital: type[ProvingHospital] = ProvingHospital) -> None:
        self.folder, self.chain = folder, hospital()
        self.genesis = self.chain.genesis
        self.network = self.make_wire()
        self.wallet = self.come_in("ann")
        self.patient = Patient("ann", handle=self.wallet.store.content.handle, keys=self.wallet.keys)
        self.room = encode_depth_png(np.full((HEIGHT, WIDTH), 5_000, dtype=np.uint16))
        self.network.custody.rooms[sha256(self.room)] = self.room
        self.taken = 0

    def make_wire(self) -> ShortWire:
        return ShortWire(self.chain)

    def open_wallet(self, name: str, words: str = "") -> Wallet:
        """A wallet on this network, of new words unless some are given. Nobody registered it."""
        store = Keystore.create(self.folder / f"{name}.wallet", words or draw_words(), "tea", CHEAP)
        wallet = Wallet(store, self.genesis)
        wallet.network = self.network  # type: ignore[assignment]
        return wallet

    def come_in(self, name: str, role: str = "subject", purposes: Sequence[str] = ("care", "demo")) -> Wallet:
        """Somebody new with a wallet, registered."""
        wallet, card = self.open_wallet(name), self.chain.card(name, role)
        arguments = self.chain.register_arguments(Patient(name, keys=wallet.keys), card, purposes=list(purposes))
        self.chain.must(wallet.keys.identity, "identity", "register", *arguments)
        wallet.store.content.handle, wallet.store.content.role = card.handle, role
        return wallet

    def open_visit(self) -> VisitChain:
        """A visit of the patient, on the chain."""
        robot = self.chain.robot.identity
        keys = open_visit_keys(
            secrets.token_bytes(32),
            self.patient.view.public_key,
            self.patient.spend.public_key,
            chain_id=self.chain.chain_id,
            robot=robot.public_key,
        )
        bucket = self.chain.bucket()
        arguments = [keys.owner, keys.ephemeral, keys.view_tag, bucket, "care"]
        self.chain.must(robot, "records", "open_visit", *arguments)
        return VisitChain(keys.owner, keys.ephemeral, keys.view_tag, "care", bucket, self.patient.sealing)

    def rendition(self) -> Rendition:
        """A frame in which the patient is a box at another place each time."""
        self.taken += 1
        box = encode_depth_png(np.full((4, 3), 1_000 + 100 * self.taken, dtype=np.uint16))
        place = (1 + self.taken % 10, 2, 3, 4)
        at = self.chain.time_ms + self.taken
        return Rendition(1, at, self.taken, WIDTH, HEIGHT, *place, sha256(self.room), "png16", box)

    def record(
        self,
        visit: VisitChain,
        frames: int = 2,
        renditions: Sequence[Rendition] = (),
        sensor: str = "depth",
        withheld: tuple[tuple[str, int], ...] = (),
    ) -> bytes:
        """Record a clip: on the chain, and at the custodians. Returns the record's id."""
        content = tuple(renditions) or tuple(self.rendition() for _ in range(frames))
        clip = seal_clip(ClipContent(content, withheld, sensor, 0), visit, now_ms=self.chain.time_ms)
        upload = clip.upload
        arguments = [upload.record_id, clip.owner, clip.commitment_root, clip.ciphertext_root, clip.sealed_metadata]
        arguments += [clip.bucket_ms, clip.expires_at_ms]
        self.chain.must(self.chain.robot.identity, "records", "record", *arguments)
        pairs = zip(upload.ciphertexts, upload.sealed_keys, strict=True)
        self.network.custody.clips[upload.record_id] = ClipDownload(
            record_id=upload.record_id,
            txid=bytes(32),
            frames=[FrameDownload(index, False, text, key) for index, (text, key) in enumerate(pairs)],
            commitment_leaves=upload.commitment_leaves,
            ciphertext_leaves=ciphertext_leaves(upload.ciphertexts, upload.sealed_keys),
        )
        return upload.record_id

    def close_visit(self, visit: VisitChain) -> None:
        self.chain.must(self.chain.robot.identity, "records", "close_visit", visit.owner, visit.record_count)

    def spoil(self, record_id: bytes, index: int) -> None:
        """Change one frame at every custodian."""
        clip = self.network.custody.clips[record_id]
        frames = list(clip.frames)
        frames[index] = msgspec.structs.replace(frames[index], ciphertext=b"x" * 200)
        self.network.custody.clips[record_id] = msgspec.structs.replace(clip, frames=frames)

    def drop(self, record_id: bytes, index: int) -> None:
        """Have every custodian destroy one frame, as an erasure asks for."""
        clip = self.network.custody.clips[record_id]
        frames = list(clip.frames)
        frames[index] = FrameDownload(index, True, b"", b"")
        self.network.custody.clips[record_id] = msgspec.structs.replace(clip, frames=frames)

    async def owner_key(self, owner: bytes) -> PrivateKey:
        """The private key of a visit, as the wallet derives it."""
        (visit,) = [visit for visit in await self.wallet.scan() if visit.owner == owner]
        return self.wallet.owner_key(visit)

    async def erase(self, visit: VisitChain, records: list[bytes], frames: Sequence[int] = ()) -> bytes:
        """Ask for an erasure, and have both custodians confirm it."""
        key = await self.owner_key(visit.owner)
        receipt = self.chain.must(key, "erasure", "request", records, list(frames))
        self.chain.receipts_of_all(receipt.txid)
        return receipt.txid

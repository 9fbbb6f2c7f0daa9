"""A ledger in memory with real blocks, certificates and proofs, and a node's services around it, for tests of the API."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import msgspec

from consensus.chain.block import (
    Block,
    EpochProof,
    FinalityProof,
    Header,
    IndexedSignature,
    QuorumCertificate,
    Receipt,
    Receipts,
    compute_receipts_root,
    compute_transactions_root,
    genesis_certificate,
)
from consensus.chain.epoch_settings import Epoch, compute_epoch_hash
from consensus.chain.genesis import ChainSettings, Genesis, NodeEntry, Organisation
from consensus.chain.messages import sign_vote
from consensus.chain.transaction import Transaction, decode_transaction
from consensus.errors import BlockRobotError
from consensus.primitives.encoding import encode, encode_value, u64
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.records.clips import ClipDownload, ClipUpload, FrameDownload
from consensus.records.commitments import ciphertext_leaves, commitment_root, derive_record_id
from consensus.state.identity import MemberRow
from consensus.state.records import RecordRow, VisitRow
from contracts.state.view import MemoryState
from node.api.ports import ApiServices
from node.api_adapters import FinalizedLedger
from node.ledger.ledger_writer import FinalityFeed
from node.limits.token_buckets import OWN, Source
from node.mempool.transaction_pool import PoolStatus, SubmitResult
from node.storage.ledger_store import FinalizedBlock
from node.storage.ledger_view import LedgerView
from node.storage.memory_store import MemoryStore
from tests.state_rows import row_of

NOW_MS = 1_760_000_000_000
PRODUCERS = tuple(PrivateKey(sha256(b"producer" + bytes([index]))) for index in range(4))
LATER_PRODUCERS = tuple(PrivateKey(sha256(b"later producer" + bytes([index]))) for index in range(4))
SUBJECT = PrivateKey(sha256(b"subject"))
ROBOT = PrivateKey(sha256(b"robot"))
REGISTRAR = PrivateKey(sha256(b"registrar"))
ADMIN = PrivateKey(sha256(b"admin"))
CUSTODIAN = PrivateKey(sha256(b"custodian"))
OWNER = PrivateKey(sha256(b"owner"))
OTHER_OWNER = PrivateKey(sha256(b"other owner"))
LEFT = PrivateKey(sha256(b"one who left"))
STRANGER = PrivateKey(sha256(b"stranger"))
_COMMITMENTS = [bytes(32), bytes(32)]
RECORD_ID = derive_record_id(OWNER.public_key, commitment_root(_COMMITMENTS))
ACCESS_ID = sha256(b"access")


def flat(contract: str, key: bytes) -> bytes:
    return contract.encode() + b"\x00" + key


def first_state() -> dict[bytes, bytes]:
    """A subject, a robot, one who left, officials, two visits with a record, three announcements."""

    def member(role: str, status: str) -> dict[str, Any]:
        handle = bytes([role == "robot"]) * 32
        return row_of(MemberRow, role=role, org="ward", since=1, status=status, handle=handle)

    visit = row_of(VisitRow, robot=ROBOT.public_key, status="open")

    values: dict[bytes, Any] = {
        flat("identity", b"member/" + SUBJECT.public_key): member("subject", "active"),
        flat("identity", b"member/" + ROBOT.public_key): member("robot", "active"),
        flat("identity", b"member/" + LEFT.public_key): member("subject", "left"),
        flat("identity", b"registrar/" + REGISTRAR.public_key): "ward",
        flat("identity", b"custodian/" + CUSTODIAN.public_key): {"name": "n0", "org": "ward"},
        flat("identity", b"admin/" + ADMIN.public_key): "ward",
        flat("identity", b"org/ward"): {"admins": [ADMIN.public_key], "registrars": [REGISTRAR.public_key]},
        flat("records", b"visit/" + OWNER.public_key): visit,
        flat("records", b"visit/" + OTHER_OWNER.public_key): visit,
        flat("records", b"record/" + RECORD_ID): row_of(RecordRow, owner=OWNER.public_key),
        flat("records", b"announcement-count"): 3,
    }
    for number in range(3):
        item = [OWNER.public_key, SUBJECT.public_key, number, 300_000 * number, ROBOT.public_key]
        values[flat("records", b"announcement/" + u64(number))] = item
    return {key: encode_value(value) for key, value in values.items()}


def make_genesis(state_root: bytes, node_count: int = 1) -> Genesis:
    nodes = tuple(
        NodeEntry(
            name=f"n{index}",
            organisation="ward",
            host="127.0.0.1",
            p2p_port=1,
            api_url="http://127.0.0.1:1",
            producer_key=key.public_key,
            producer_possession=b"",
            custodian_key=CUSTODIAN.public_key if index == 0 else b"",
        )
        for index, key in enumerate(PRODUCERS)
    )
    return Genesis(
        version=1,
        network="test",
        created_at_ms=NOW_MS,
        settings=ChainSettings(),
        organisations=(
            Organisation(
                name="ward", ca_certificate="", admins=(ADMIN.public_key,), registrars=(REGISTRAR.public_key,)
            ),
        ),
        nodes=nodes,
        contracts=(),
        purposes=("care",),
        state_root=state_root,
    )


@dataclass
class ManualClock:
    time_ms: int = NOW_MS

    def now_ms(self) -> int:
        return self.time_ms


class SmallLedger:
    """Blocks on a `MemoryStore`, each certified by all that is needed, one round each."""

    def __init__(self) -> None:
        self.state = MemoryState()
        update = self.state.apply(first_state())
        self.genesis = make_genesis(self.state.state_root)
        self.store = MemoryStore()
        self.feed = FinalityFeed(0)
        block = self.genesis.block()
        self.header = block.header
        self.qc = genesis_certificate(self.genesis.block_id)
        self.epoch = self.genesis.epoch
        self._first = FinalizedBlock(
            height=0,
            block_id=block.block_id,
            block_bytes=encode(block),
            receipts_bytes=encode(Receipts(receipts=())),
            timestamp_ms=self.header.timestamp_ms,
            state_root=self.state.state_root,
            state_writes=first_state(),
            page_writes=update.pages,
        )

    async def start(self) -> SmallLedger:
        await self.store.commit([self._first], b"")
        return self

    def _certify(self, header: Header) -> QuorumCertificate:
        block_id = sha256(encode(header))
        known = {key.public_key: key for key in (*PRODUCERS, *LATER_PRODUCERS)}
        keys = [known[public_key] for public_key in self.epoch.producers]
        chain_id, epoch = self.genesis.chain_id, self.epoch.number
        votes = [sign_vote(key, chain_id, epoch, header.round, block_id, i) for i, key in enumerate(keys)]
        return QuorumCertificate(
            epoch=epoch,
            round=header.round,
            block_id=block_id,
            votes=tuple(IndexedSignature(index=v.index, signature=v.signature) for v in votes[:3]),
        )

    def _header(
        self,
        parent: Header,
        qc: QuorumCertificate,
        receipts: tuple[Receipt, ...],
        gap: int,
        next_epoch: Epoch | None = None,
    ) -> Header:
        return Header(
            version=1,
            chain_id=self.genesis.chain_id,
            epoch=self.epoch.number,
            height=parent.height + 1,
            round=(parent.round if parent.epoch == self.epoch.number else 0) + 1 + gap,
            parent_id=sha256(encode(parent)),
            qc=qc,
            tc=None,
            producer=0,
            timestamp_ms=parent.timestamp_ms + 1,
            transactions_root=compute_transactions_root([receipt.txid for receipt in receipts]),
            receipts_root=compute_receipts_root(receipts),
            state_root=self.state.state_root,
            next_schedule_hash=None if next_epoch is None else compute_epoch_hash(next_epoch),
            gas_used=0,
            is_closing=parent.is_boundary and parent.epoch == self.epoch.number,
        )

    async def change_epoch(self, **changes: Any) -> Header:
        """Finalize a boundary: other producers decide from here on, unless `changes` of the epoch say otherwise."""
        producers = {"producers": tuple(key.public_key for key in LATER_PRODUCERS)}
        epoch = msgspec.structs.replace(self.epoch, **(producers | changes | {"number": self.epoch.number + 1}))
        header = await self.extend(next_epoch=epoch)
        self.epoch, self.qc = epoch, genesis_certificate(sha256(encode(header)), epoch.number)
        return header

    async def extend(
        self,
        transactions: Sequence[Transaction] = (),
        receipts: tuple[Receipt, ...] = (),
        writes: dict[bytes, bytes | None] | None = None,
        *,
        gap: int = 0,
        next_epoch: Epoch | None = None,
    ) -> Header:
        """Finalize one block. `gap` rounds are lost before it."""
        update = self.state.apply(writes or {})
        header = self._header(self.header, self.qc, receipts, gap, next_epoch)
        qc = self._certify(header)
        child = self._header(header, qc, (), 0)
        proof = FinalityProof(
            header_bytes=encode(header), child_header_bytes=encode(child), child_qc=self._certify(child)
        )
        block = Block(
            header_bytes=encode(header), signature=bytes(64), transactions=tuple(t.wire for t in transactions)
        )
        stored = FinalizedBlock(
            height=header.height,
            block_id=block.block_id,
            block_bytes=encode(block),
            receipts_bytes=encode(Receipts(receipts=receipts)),
            events=[encode(event) for receipt in receipts for event in receipt.events],
            timestamp_ms=header.timestamp_ms,
            state_root=header.state_root,
            transactions=[(t.txid, t.body.valid_until_ms) for t in transactions],
            state_writes=writes or {},
            page_writes=update.pages,
            epoch_proof_bytes=b"" if next_epoch is None else encode(EpochProof(finality=proof, epoch=next_epoch)),
        )
        position = await self.store.commit([stored], encode(proof))
        self.header, self.qc = header, qc
        self.feed.publish([], proof, position)
        for transaction in transactions:
            self.feed._resolve(transaction.txid, final=True)
        return header


@dataclass
class FakePool:
    """Admits what is signed for the chain; `on_submit` may finalize at once."""

    ledger: SmallLedger
    clock: ManualClock
    waiting: dict[bytes, Transaction] = field(default_factory=dict)
    expired: set[bytes] = field(default_factory=set)
    submissions: list[bytes] = field(default_factory=list)
    sources: list[Source] = field(default_factory=list)
    refuse_with: str | None = None
    finalize_at_once: bool = False
    fault: Exception | None = None
    waited_for: asyncio.Event = field(default_factory=asyncio.Event)

    async def submit(self, wires: Sequence[bytes], source: Source = OWN) -> Sequence[SubmitResult]:
        if self.fault is not None:
            raise self.fault
        self.sources.append(source)
        results = [self._admit(wire) for wire in wires]
        if self.finalize_at_once and self.waiting:
            await self.finalize()
        return results

    def _admit(self, wire: bytes) -> SubmitResult:
        try:
            transaction = decode_transaction(wire)
        except BlockRobotError as error:
            return SubmitResult(b"", error)
        self.submissions.append(transaction.txid)
        if self.refuse_with is not None:
            return SubmitResult(transaction.txid, BlockRobotError(self.refuse_with))
        with self.ledger.store.snapshot() as snapshot:
            if snapshot.locate(transaction.txid) is not None:
                return SubmitResult(transaction.txid, BlockRobotError("TRANSACTION_REPLAYED"))
        self.waiting[transaction.txid] = transaction
        return SubmitResult(transaction.txid, None)

    async def finalize(self, code: str = "OK", **kwargs: Any) -> None:
        transactions = list(self.waiting.values())
        self.waiting.clear()
        receipts = tuple(
            Receipt(txid=t.txid, ok=code == "OK", code=code, message="", line=None, gas_used=7, events=())
            for t in transactions
        )
        await self.ledger.extend(transactions, receipts, **kwargs)

    def status(self, txid: bytes) -> PoolStatus:
        if txid in self.expired:
            return "expired"
        return "pending" if txid in self.waiting else "unknown"

    async def wait_final(self, txid: bytes, timeout_ms: int) -> bool:
        self.waited_for.set()
        return await self.ledger.feed.wait_final(txid, timeout_ms)


class EchoViews:
    """`echo.back` returns its arguments; every other call is refused or unknown."""

    async def run_view(
        self, snapshot: LedgerView, contract: str, view: str, arguments: list[Any], _source: Source = OWN
    ) -> bytes:
        if (contract, view) == ("echo", "back"):
            return encode_value(arguments)
        if contract == "echo":
            raise BlockRobotError("CALL_REFUSED", "NOT_TODAY: Try tomorrow.")
        raise BlockRobotError("TRANSACTION_CONTRACT_UNKNOWN")


@dataclass
class FakeCustody:
    staged: dict[bytes, tuple[ClipUpload, bytes]] = field(default_factory=dict)
    backgrounds: dict[bytes, bytes] = field(default_factory=dict)
    granted: set[bytes] = field(default_factory=lambda: {ACCESS_ID})
    refuses: str | None = None

    @property
    def admission(self) -> FakeCustody:
        return self

    @asynccontextmanager
    async def clip(self, record_id: bytes, owner: bytes, size_bytes: int, robot: bytes) -> AsyncIterator[None]:
        if self.refuses is not None:
            raise BlockRobotError(self.refuses)
        yield

    @asynccontextmanager
    async def background(self, digest: bytes, size_bytes: int, robot: bytes) -> AsyncIterator[None]:
        if self.refuses is not None:
            raise BlockRobotError(self.refuses)
        yield

    async def stage(self, upload: ClipUpload, robot: bytes, *, is_new: bool = True) -> None:
        self.staged[upload.record_id] = (upload, robot)

    async def download(self, record_id: bytes, access_id: bytes, owner: bytes) -> ClipDownload:
        if access_id not in self.granted:
            raise BlockRobotError("ACCESS_NOT_GRANTED")
        upload, _ = self.staged[record_id]
        frames = [
            FrameDownload(index=index, erased=False, ciphertext=text, sealed_key=key)
            for index, (text, key) in enumerate(zip(upload.ciphertexts, upload.sealed_keys, strict=True))
        ]
        return ClipDownload(
            record_id=record_id,
            txid=upload.txid,
            frames=frames,
            commitment_leaves=upload.commitment_leaves,
            ciphertext_leaves=ciphertext_leaves(upload.ciphertexts, upload.sealed_keys),
        )

    async def put_background(self, digest: bytes, content: bytes, robot: bytes) -> None:
        self.backgrounds[digest] = content

    async def get_background(self, digest: bytes) -> bytes | None:
        return self.backgrounds.get(digest)


def make_upload() -> ClipUpload:
    return ClipUpload(
        record_id=RECORD_ID,
        txid=bytes(32),
        valid_until_ms=NOW_MS + 60_000,
        ciphertexts=[bytes(100), bytes(101)],
        sealed_keys=[bytes(80), bytes(80)],
        commitment_leaves=_COMMITMENTS,
        owner=OWNER.public_key,
    )


@dataclass
class SmallNode:
    """All services of one node."""

    ledger: SmallLedger
    clock: ManualClock
    pool: FakePool
    custody: FakeCustody
    services: ApiServices

    @staticmethod
    def around(ledger: SmallLedger, name: str = "n0") -> SmallNode:
        clock, custody = ManualClock(), FakeCustody()
        pool = FakePool(ledger, clock)
        services = ApiServices(
            genesis=ledger.genesis,
            node_name=name,
            clock=clock,
            ledger=FinalizedLedger(ledger.store, ledger.feed),
            views=EchoViews(),
            pool=pool,
            custody=custody,
        )
        return SmallNode(ledger, clock, pool, custody, services)

    def without_custody(self) -> SmallNode:
        return replace(self, services=replace(self.services, custody=None))

"""A ward in which things are shared: real contracts, real proofs and real wallets; custodians are objects that obey."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from clients.robot.recording.sealing import VisitChain
from clients.sdk.chain.receipts import FinalReceipt
from clients.sdk.chain.transactions import TransactionBuilder
from clients.sdk.connections import NodeAddress
from clients.sdk.proof_checks import ProvedState
from clients.sdk.sessions import GrantKey
from clients.wallet.ledger.wallet import RecordEntry, Wallet
from clients.wallet.sharing.incoming_shares import IncomingShares
from clients.wallet.sharing.outgoing_shares import FinalGrant, Grantee, SharingClient
from clients.wallet.store.keystore import KnownVisit
from consensus.api_documents import ProofsAnswer
from consensus.chain.block import FinalityProof, Header
from consensus.chain.transaction import Transaction
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from consensus.records.sharing import (
    GRANT_STEP_MS,
    GRANTEE_ROLES,
    GrantUpload,
    SharedDownload,
    SharedRequest,
    build_shared_download,
    check_grant_upload,
    hash_grant_member,
)
from consensus.state.identity import active_role
from contracts.state.view import MemoryState
from node.api.access.principals import require_readable, resolve_principal
from tests.unit.contracts.privacy.hospital import key_of
from tests.world.ward import Custodians, ProvingHospital, ShortWire, Ward

WEEK_MS = 7 * 24 * 3600 * 1000


@dataclass
class SharedCustody(Custodians):
    """Custodians that take parts, and hand them out as the chain says; `away` ones answer nobody."""

    chain: ProvingHospital
    away: set[str] = field(default_factory=set)
    parts: dict[tuple[str, bytes, bytes], GrantUpload] = field(default_factory=dict)
    uploaders: list[bytes] = field(default_factory=list)
    lie: Callable[[str, SharedDownload], SharedDownload] = lambda _, answer: answer
    asked_frames: list[bool] = field(default_factory=list)
    not_yet: int = 0

    def __post_init__(self) -> None:
        super().__init__()
        self.custodians = tuple(NodeAddress(name, "http://127.0.0.1:2") for name in self.chain.custodian_names)

    def _require_there(self, node: NodeAddress) -> None:
        if node.name in self.away:
            raise BlockRobotError("NODE_UNREACHABLE", f"{node.name} does not answer.")

    async def upload_grant(self, node: NodeAddress, upload: GrantUpload, key: PrivateKey) -> None:
        self._require_there(node)
        if self.not_yet:
            self.not_yet -= 1
            raise BlockRobotError("CLIP_NOT_CONFIRMED")
        check_grant_upload(upload)
        self.parts[node.name, upload.grant_txid, upload.record_id] = upload
        self.uploaders.append(key.public_key)

    async def download_shared(
        self, node: NodeAddress, grant_id: bytes, request: SharedRequest, key: PrivateKey
    ) -> SharedDownload:
        self._require_there(node)
        access = self.chain.value("access", b"access/" + request.access_id)
        grant = self.chain.value("access", b"grant/" + grant_id)
        if access is None or access.get("grant") != grant_id or grant["grantee"] != key.public_key:
            raise BlockRobotError("ACCESS_NOT_GRANTED")
        if grant["status"] != "active" or request.record_id not in access["records"]:
            raise BlockRobotError("GRANT_ENDED")
        member = self.chain.value("identity", b"handle/" + request.handle)
        role = active_role(self.chain.state, member or b"")
        if hash_grant_member(request.salt, request.handle) != grant["member_hash"] or role not in GRANTEE_ROLES:
            raise BlockRobotError("GRANTEE_NOT_A_MEMBER")
        self.asked_frames.append(request.with_frames)
        kept = self.parts[node.name, grant_id, request.record_id]
        custodian = key_of(node.name)
        self.chain.must(custodian, "access", "released", request.access_id, [request.record_id])
        answer = build_shared_download(
            self.clips[request.record_id],
            custodian.public_key,
            kept.package,
            kept.parts,
            with_frames=request.with_frames,
        )
        return self.lie(node.name, answer)


class SharingWire(ShortWire):
    """One wallet's network, on the chain of all."""

    custody: SharedCustody

    def __init__(self, chain: ProvingHospital, custody: SharedCustody) -> None:
        super().__init__(chain)
        self.custody = custody
        self.transactions = TransactionBuilder(chain.chain_id, self)
        self.refusal = ""
        self.callers: list[bytes] = []
        self.nodes = tuple(NodeAddress(name, "http://127.0.0.1:2") for name in chain.custodian_names)
        self.away: set[str] = set()
        self._kept: tuple[FinalityProof, MemoryState] | None = None

    def keep_quiet(self) -> None:
        """The first node, which answers all that is asked of state, says nothing of later blocks from now on."""
        self._kept = (self.chain.finality(), self.chain.state.copy())

    def _answer(self, keys: Sequence[bytes]) -> ProofsAnswer:
        if self._kept is None:
            return super()._answer(keys)
        now, (finality, state) = self.chain, self._kept
        self.chain = SimpleNamespace(state=state, finality=lambda: finality)  # type: ignore[assignment]
        try:
            return super()._answer(keys)
        finally:
            self.chain = now

    async def node_header(self, node: NodeAddress, key: PrivateKey) -> Header:
        if node.name in self.away:
            raise BlockRobotError("NODE_UNREACHABLE")
        is_quiet = self._kept is not None and node == self.nodes[0]
        return self.light_client.accept(self._kept[0] if self._kept and is_quiet else self.chain.finality())

    async def state_values(self, keys: Sequence[bytes], key: PrivateKey) -> ProvedState:
        """Answer the key of a grant what a node does, by the same rules: of that grant's visit, and to nobody else."""
        if isinstance(key, GrantKey):
            state = self.chain.state
            snapshot: Any = SimpleNamespace(header=self.chain.head, get=state.get)
            standing = resolve_principal(snapshot, key.public_key, key.grant_id)
            if standing is None:
                raise BlockRobotError("SESSION_REFUSED")
            require_readable(snapshot, standing.kind, key.public_key, key.grant_id, keys)
        return await super().state_values(keys, key)

    def now_ms(self) -> int:
        return self.chain.time_ms

    async def newest_header(self, key: PrivateKey) -> Header:
        self.callers.append(key.public_key)
        return await super().newest_header(key)

    async def submit_and_wait(self, transaction: Transaction) -> FinalReceipt:
        if self.refusal:
            raise BlockRobotError(self.refusal)
        self.chain.block([transaction])
        return await self.wait_final(transaction.txid)


class ThreeCustodians(ProvingHospital):
    """The hospital's chain, with one custodian more."""

    custodian_names = ("custodian-1", "custodian-2", "custodian-3")


class SharedWard(Ward):
    """Ann, who was recorded; and whoever comes in with a wallet of his own."""

    network: SharingWire

    def __init__(self, folder: Path, hospital: type[ProvingHospital] = ProvingHospital) -> None:
        super().__init__(folder, hospital)
        self.custody = self.network.custody
        self.wallet.network = self.network  # type: ignore[assignment]
        self.pauses_s: list[float] = []
        self.sharing = SharingClient(self.wallet, sleep=self._pause)
        self.told: list[str] = []

    async def _pause(self, seconds: float) -> None:
        self.pauses_s.append(seconds)

    def make_wire(self) -> SharingWire:
        return SharingWire(self.chain, SharedCustody(self.chain))

    def open_wallet(self, name: str, words: str = "") -> Wallet:
        """A wallet as everybody's, with a wire of its own."""
        wallet = super().open_wallet(name, words)
        wallet.network = SharingWire(self.chain, self.network.custody)  # type: ignore[assignment]
        return wallet

    def record_visit(self, count: int = 2) -> tuple[VisitChain, list[bytes]]:
        """A visit with records, on the chain and at the custodians."""
        visit = self.open_visit()
        ids = [self.record(visit) for _ in range(count)]
        self.close_visit(visit)
        return visit, ids

    def until_ms(self, ahead_ms: int = WEEK_MS) -> int:
        return -(-(self.chain.time_ms + ahead_ms) // GRANT_STEP_MS) * GRANT_STEP_MS

    async def grantee(self, wallet: Wallet, label: str = "Dr Weber") -> Grantee:
        return await self.sharing.resolve_grantee(wallet.store.content.handle.hex(), label)

    async def entries(self) -> list[RecordEntry]:
        return [entry for report in await self.wallet.records() for entry in report.records]

    async def share(self, wallet: Wallet, purpose: str = "care", **given: Any) -> FinalGrant:
        """Share all of the patient's records with somebody, for a week."""
        entries = await self.entries()
        grantee = await self.grantee(wallet, given.get("label", "Dr Weber"))
        until_ms = given.get("until_ms", self.until_ms())
        return await self.sharing.share(entries, grantee, purpose, until_ms, self.told.append)

    def receiving(self, wallet: Wallet) -> IncomingShares:
        async def no_sleep(_: float) -> None:
            """Time passes."""

        return IncomingShares(wallet, follow_max_ms=0, sleep=no_sleep)

    async def known_visit(self) -> KnownVisit:
        (visit,) = await self.wallet.scan()
        return visit

"""A person, a robot that recorded her, and a network held in dicts: the robot's and the wallet's own code, no node."""

from __future__ import annotations

import secrets
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeVar

import click
import msgspec
from nacl import pwhash

from clients.robot.recording.sealing import ClipContent, VisitChain, seal_clip
from clients.robot.recording.spool import SpooledClip
from clients.sdk.chain.announcements import Announcement, AnnouncementPage
from clients.sdk.connections import NodeAddress
from clients.sdk.passphrase import PassphraseCost
from clients.sdk.proof_checks import ProvedState
from clients.wallet.cli import main
from clients.wallet.ledger.wallet import Wallet
from clients.wallet.store.keystore import Keystore
from clients.wallet.store.member_keys import WalletKeys, derive_keys, draw_words
from consensus.chain.genesis import GENESIS_VERSION, ChainSettings, Genesis, NodeEntry, Organisation
from consensus.errors import BlockRobotError
from consensus.primitives.keys import PrivateKey
from consensus.records.clips import ClipDownload, FrameDownload
from consensus.records.commitments import ciphertext_leaves
from consensus.records.owner_keys import open_visit_keys
from consensus.records.renditions import Rendition
from consensus.state.audit import COUNT, ENTRY, EntryRow
from consensus.state.keys import Prefix, to_value
from consensus.state.records import RECORD, VISIT, RecordRow, VisitRow

NOW_MS = 1_800_000_000_000
T = TypeVar("T")
ROBOT = PrivateKey(bytes([6] * 32)).public_key
CHEAP = PassphraseCost(pwhash.argon2id.OPSLIMIT_MIN, pwhash.argon2id.MEMLIMIT_MIN)


def make_genesis() -> Genesis:
    keys = [PrivateKey(bytes([number] * 32)).public_key for number in range(1, 5)]
    return Genesis(
        version=GENESIS_VERSION,
        network="test",
        created_at_ms=NOW_MS - 10**6,
        settings=ChainSettings(),
        organisations=(Organisation(name="hospital", ca_certificate="", admins=(keys[0],), registrars=(keys[1],)),),
        nodes=(NodeEntry("node-1", "hospital", "127.0.0.1", 1, "http://127.0.0.1:2", keys[2], bytes(64), keys[3]),),
        contracts=(),
        purposes=("demo", "own-access"),
        state_root=bytes(32),
    )


@contextmanager
def typed_for(profile: str, **places: Path | None) -> Iterator[None]:
    """While inside, as while a command runs for the wallet of this profile; `wallet_dir` and `genesis` if named."""
    context = click.Context(main.wallet)
    context.params = {"profile": profile, "wallet_dir": None, "genesis": None, **places}
    with context:
        yield


def rendition(sequence: int) -> Rendition:
    return Rendition(1, NOW_MS + sequence, sequence, 64, 48, 1, 2, 3, 4, bytes(32), "png16", secrets.token_bytes(50))


@dataclass
class FakeCustody:
    """Custodians by name, each with clips by record id, or with a code by which it refuses everything."""

    clips: dict[str, dict[bytes, ClipDownload]]
    refusals: dict[str, str] = field(default_factory=dict)
    asked: list[tuple[str, bytes]] = field(default_factory=list)
    late_answers: int = 0

    @property
    def custodians(self) -> tuple[NodeAddress, ...]:
        return tuple(NodeAddress(name, "http://127.0.0.1:2") for name in self.clips)

    def keepers_first(self, _record_id: bytes) -> tuple[NodeAddress, ...]:
        return self.custodians

    async def download_clip(
        self, node: NodeAddress, record_id: bytes, access_id: bytes, key: PrivateKey
    ) -> ClipDownload:
        self.asked.append((node.name, key.public_key))
        if node.name in self.refusals:
            raise BlockRobotError(self.refusals[node.name])
        if self.late_answers:
            self.late_answers -= 1
            raise BlockRobotError("ACCESS_NOT_GRANTED")
        return self.clips[node.name][record_id]


@dataclass(frozen=True)
class Receipt:
    txid: bytes
    evidence: None = None
    transaction: None = None


@dataclass(frozen=True)
class Answer:
    """A final receipt with one event, as the chain would write it."""

    txid: bytes
    data: dict[str, Any]
    height: int = 7
    timestamp_ms: int = NOW_MS

    def event_data(self, contract: str, name: str) -> list[dict[str, Any]]:
        return [self.data | {"event": f"{contract}.{name}"}]


@dataclass
class Saying:
    """Stands for the network's `call`; notes who said what."""

    data: dict[str, Any] = field(default_factory=lambda: {"height": 8, "until_ms": 0, "number": 0})
    refusal: str = ""
    said: list[tuple[bytes, str, list[Any]]] = field(default_factory=list)

    async def __call__(self, key: Any, contract: str, entry: str, arguments: list[Any]) -> Answer:
        if self.refusal:
            raise BlockRobotError(self.refusal)
        self.said.append((key.public_key, f"{contract}.{entry}", arguments))
        return Answer(len(self.said).to_bytes(32, "big"), self.data)


class FakeNetwork:
    """State as the chain would hold it. Every question is noted with the key in whose session it was asked."""

    pinned = b"pinned"
    known_custodians = ()

    def __init__(self) -> None:
        self.state: dict[bytes, Any] = {}
        self.announced: list[Announcement] = []
        self.trails: dict[bytes, list[EntryRow]] = {}
        self.custody = FakeCustody({"node-1": {}, "node-2": {}})
        self.calls: list[tuple[bytes, str, str, list[Any]]] = []
        self.asked: list[tuple[str, bytes]] = []
        self.refusal = ""
        self.pages_of = 2

    async def close(self) -> None:
        """Nothing is open."""

    async def state_values(self, keys: Sequence[bytes], key: PrivateKey) -> ProvedState:
        self.asked.extend((flat.decode("latin-1"), key.public_key) for flat in keys)
        assert len(keys) <= 128
        return ProvedState(height=9, timestamp_ms=NOW_MS, values={flat: self.state.get(flat) for flat in keys})

    async def query(self, contract: str, view: str, arguments: list[Any], key: PrivateKey) -> Any:
        raise AssertionError(f"the wallet asked for {contract}.{view}, which no node can prove")

    async def announcements(self, first: int, key: PrivateKey) -> AnnouncementPage:
        self.asked.append(("announcements", key.public_key))
        items = tuple(self.announced[first : first + self.pages_of])
        return AnnouncementPage(count=len(self.announced), items=items, next_number=first + len(items))

    async def call(self, key: PrivateKey, contract: str, entry: str, arguments: list[Any]) -> Receipt:
        if self.refusal:
            raise BlockRobotError("CALL_REFUSED", self.refusal)
        self.calls.append((key.public_key, contract, entry, arguments))
        return Receipt(len(self.calls).to_bytes(32, "big"))


class World:
    """One wallet on one fake network, and what the robot does there."""

    def __init__(self, folder: Path) -> None:
        self.genesis = make_genesis()
        self.network = FakeNetwork()
        self.store = Keystore.create(folder / "ann.wallet", draw_words(), "tea", CHEAP)
        self.store.content.handle = b"h" * 32
        self.wallet = Wallet(self.store, self.genesis)
        self.wallet.network = self.network  # type: ignore[assignment]
        self.keys = self.wallet.keys

    def stranger(self) -> WalletKeys:
        return derive_keys(draw_words())

    def open_visit(self, keys: WalletKeys | None = None) -> VisitChain:
        """Open a visit of this person (or of a stranger) and announce it."""
        keys = keys or self.keys
        visit = open_visit_keys(
            secrets.token_bytes(32),
            keys.view.public_key,
            keys.spend.public_key,
            chain_id=self.genesis.chain_id,
            robot=ROBOT,
        )
        number = len(self.network.announced)
        self.network.announced.append(
            Announcement(number, visit.owner, visit.ephemeral, visit.view_tag, NOW_MS - NOW_MS % 300_000, ROBOT)
        )
        self.put_visit(visit.owner, "open")
        return VisitChain(
            owner=visit.owner,
            ephemeral=visit.ephemeral,
            view_tag=visit.view_tag,
            purpose="demo",
            bucket_ms=0,
            sealing=keys.sealing_public,
        )

    def record(self, visit: VisitChain, frames: int = 3) -> SpooledClip:
        """Record a clip: its state on the chain, its bytes at both custodians."""
        content = ClipContent(tuple(rendition(number) for number in range(frames)), (), "depth", NOW_MS)
        clip = seal_clip(content, visit, now_ms=NOW_MS)
        self.hold(clip)
        return clip

    def hold(self, clip: SpooledClip, robot: bytes = ROBOT) -> None:
        """Put a clip's state on the chain and its bytes at both custodians, and announce its visit if need be."""
        upload = clip.upload
        if clip.owner not in self.network.trails:
            number = len(self.network.announced)
            self.network.announced.append(
                Announcement(number, clip.owner, clip.ephemeral, clip.view_tag, clip.visit_bucket_ms, robot)
            )
            self.put_visit(clip.owner, "open")
        self.put_record(
            upload.record_id,
            clip.owner,
            commitment_root=clip.commitment_root,
            ciphertext_root=clip.ciphertext_root,
            sealed_metadata=clip.sealed_metadata,
            expires_at_ms=clip.expires_at_ms,
        )
        self.append_audit(clip.owner, "recorded", upload.record_id)
        pairs = zip(upload.ciphertexts, upload.sealed_keys, strict=True)
        download = ClipDownload(
            record_id=upload.record_id,
            txid=bytes(32),
            frames=[FrameDownload(index, False, text, key) for index, (text, key) in enumerate(pairs)],
            commitment_leaves=upload.commitment_leaves,
            ciphertext_leaves=ciphertext_leaves(upload.ciphertexts, upload.sealed_keys),
        )
        for clips in self.network.custody.clips.values():
            clips[upload.record_id] = download

    def change_frame(self, custodian: str, record_id: bytes, index: int, **changes: Any) -> None:
        """Change one frame at one custodian."""
        clips = self.network.custody.clips[custodian]
        frames = list(clips[record_id].frames)
        frames[index] = msgspec.structs.replace(frames[index], **changes)
        clips[record_id] = msgspec.structs.replace(clips[record_id], frames=frames)

    def close_visit(self, visit: VisitChain) -> None:
        self.put_visit(visit.owner, "closed", visit.record_count)

    def put(self, rows: Prefix[T], row: T, *parts: bytes | int) -> None:
        """Let a row stand on the chain."""
        self.network.state[rows.key(*parts)] = to_value(row)

    def change(self, rows: Prefix[Any], *parts: bytes | int, **changes: Any) -> None:
        """Let a row that stands there have other fields."""
        row = rows.convert(self.network.state[rows.key(*parts)])
        self.put(rows, msgspec.structs.replace(row, **changes), *parts)

    def put_visit(self, owner: bytes, status: Literal["open", "closed"], record_count: int = 0) -> None:
        """Let a visit stand on the chain."""
        row = VisitRow(ROBOT, ROBOT, 0, 0, "demo", status, record_count, 1, 0)
        self.put(VISIT, row, owner)
        self.network.trails.setdefault(owner, [])

    def put_record(self, record_id: bytes, owner: bytes, **fields: Any) -> None:
        """Let a record stand on the chain."""
        row = RecordRow(owner, ROBOT, b"", b"", b"", NOW_MS, NOW_MS, 1, bytes(32), "active", [], [])
        self.put(RECORD, msgspec.structs.replace(row, **fields), record_id)

    def write_audit(self, visit: VisitChain, kinds: list[str], height: int = 1) -> None:
        for kind in kinds:
            self.append_audit(visit.owner, kind, height=height)

    def append_audit(
        self, owner: bytes, kind: str, record_id: bytes = b"", *, height: int = 1, data: dict[str, Any] | None = None
    ) -> None:
        trail = self.network.trails[owner]
        index = len(trail)
        trail.append(EntryRow(record_id, kind, NOW_MS + index, height + 2 * index, data or {}))
        self.put(COUNT, len(trail), owner)
        self.put(ENTRY, trail[-1], owner, index)

    def withhold(self, owner: bytes, record_id: bytes) -> None:
        """Let the robot never have brought this record to the chain."""
        del self.network.state[RECORD.key(record_id)]
        kept = [entry for entry in self.network.trails[owner] if entry.record_id != record_id]
        self.network.trails[owner] = []
        for entry in kept:
            self.append_audit(owner, entry.kind, entry.record_id)

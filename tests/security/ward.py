"""A patient, a robot and a visit on a running network, with all the secrets that they hold. For the tests here."""

from __future__ import annotations

import secrets
from dataclasses import dataclass, field
from typing import Any

import msgspec
from nacl.public import PrivateKey as SealingKey

from clients.sdk.chain.enrolment import NewMember
from consensus.chain.transaction import Transaction
from consensus.limits import RETENTION_DEFAULT_MS, SEALED_METADATA_BYTES, TIME_BUCKET_MS
from consensus.members.vouchers import Card
from consensus.primitives.encoding import encode
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.records.clips import ClipUpload
from consensus.records.commitments import (
    ciphertext_leaves,
    ciphertext_root,
    commitment_root,
    derive_record_id,
    frame_commitment,
)
from consensus.records.envelopes import seal_data_key, seal_frame
from consensus.records.owner_keys import derive_owner_key, open_visit_keys
from tests.security.intruder import MSGPACK, Intruder, new_key, now_ms


@dataclass
class Enrolled:
    """Somebody registered, with the private side of the four keys and of the card."""

    identity: PrivateKey = field(default_factory=new_key)
    spend: PrivateKey = field(default_factory=new_key)
    view: PrivateKey = field(default_factory=new_key)
    sealing: SealingKey = field(default_factory=SealingKey.generate)
    card: Card | None = None

    @property
    def member(self) -> NewMember:
        return NewMember(self.identity, self.spend.public_key, self.view.public_key, bytes(self.sealing.public_key))


@dataclass
class Clip:
    """A sealed clip, the data keys of its frames, and what it shows."""

    upload: ClipUpload
    data_keys: list[bytes]
    plaintexts: list[bytes]


def _bucket() -> int:
    now = now_ms()  # read once: a millisecond may pass between two looks at the clock
    return now - now % TIME_BUCKET_MS


class Ward:
    """One robot and one patient whose visit is open."""

    def __init__(self, intruder: Intruder) -> None:
        self.intruder = intruder
        self.patient, self.robot = Enrolled(), Enrolled()
        self.visit_secret = new_key().secret
        self.owner = new_key()

    async def enrol(self, who: Enrolled, role: str) -> None:
        who.card = who.card or self.intruder.card(role=role)
        receipt = await self.intruder.final(self.intruder.registration(who.card, who.member))
        assert receipt["ok"], receipt

    async def open(self) -> None:
        """Enrol both and open the visit."""
        await self.enrol(self.patient, "subject")
        await self.enrol(self.robot, "robot")
        robot, chain_id = self.robot.identity.public_key, self.intruder.genesis.chain_id
        member = self.patient.member
        keys = open_visit_keys(self.visit_secret, member.view, member.spend, chain_id=chain_id, robot=robot)
        self.owner = derive_owner_key(
            self.patient.spend, self.patient.view, keys.ephemeral, chain_id=chain_id, robot=robot
        )
        assert self.owner.public_key == keys.owner
        await self.must(
            self.robot.identity, "records", "open_visit", keys.owner, keys.ephemeral, keys.view_tag, _bucket(), "demo"
        )

    async def approve(self, approver: PrivateKey, *contents: bytes) -> None:
        """Have empty frames of this robot approved by a person of its organisation."""
        robot = self.robot.identity.public_key
        await self.must(approver, "records", "approve_empty_frames", robot, [sha256(content) for content in contents])

    async def must(self, key: PrivateKey, contract: str, entry: str, *arguments: Any) -> Transaction:
        call = self.intruder.call(key, contract, entry, *arguments)
        receipt = await self.intruder.final(call)
        assert receipt["ok"], receipt
        return call

    def clip(self, frames: int = 2, **changes: Any) -> Clip:
        """Seal a clip for the patient."""
        data_keys = [secrets.token_bytes(32) for _ in range(frames)]
        plaintexts = [b"what the patient looks like " + secrets.token_bytes(32) for _ in range(frames)]
        pairs = list(enumerate(zip(data_keys, plaintexts, strict=True)))
        leaves = [frame_commitment(key, index, text) for index, (key, text) in pairs]
        record_id = derive_record_id(self.owner.public_key, commitment_root(leaves))
        fields: dict[str, Any] = {
            "record_id": record_id,
            "txid": bytes(32),
            "valid_until_ms": now_ms() + 60_000,
            "ciphertexts": [seal_frame(key, secrets.token_bytes(24), record_id, i, text) for i, (key, text) in pairs],
            "sealed_keys": [seal_data_key(bytes(self.patient.sealing.public_key), key) for key in data_keys],
            "commitment_leaves": leaves,
            "owner": self.owner.public_key,
        }
        return Clip(ClipUpload(**(fields | changes)), data_keys, plaintexts)

    def resealed(self, clip: Clip) -> Clip:
        """The same pictures, keys and id in other bytes."""
        pairs = list(enumerate(zip(clip.data_keys, clip.plaintexts, strict=True)))
        record_id = clip.upload.record_id
        texts = [seal_frame(key, secrets.token_bytes(24), record_id, index, text) for index, (key, text) in pairs]
        return Clip(msgspec.structs.replace(clip.upload, ciphertexts=texts), clip.data_keys, clip.plaintexts)

    def record_call(self, clip: Clip) -> Transaction:
        """The record of a clip."""
        upload = clip.upload
        roots = (
            commitment_root(upload.commitment_leaves),
            ciphertext_root(ciphertext_leaves(upload.ciphertexts, upload.sealed_keys)),
        )
        expires_at_ms = _bucket() + RETENTION_DEFAULT_MS
        return self.intruder.call(
            self.robot.identity,
            "records",
            "record",
            upload.record_id,
            self.owner.public_key,
            *roots,
            bytes(SEALED_METADATA_BYTES),
            _bucket(),
            expires_at_ms,
        )

    async def upload(self, upload: ClipUpload, custodian: str, token: dict[str, str]) -> tuple[int, bytes]:
        status, _, body = await self.intruder.ask(
            "PUT",
            f"/v1/clips/{upload.record_id.hex()}?owner={upload.owner.hex()}",
            data=encode(upload),
            headers=token | {"Content-Type": MSGPACK},
            node=custodian,
        )
        return status, body

"""People and robots of the hospital, with the keys of real wallets, and clips sealed to them: all from the seed."""

from __future__ import annotations

import hashlib
from collections import Counter
from dataclasses import dataclass, field

from mnemonic import Mnemonic
from msgspec import structs
from nacl.public import Box, PublicKey
from nacl.public import PrivateKey as SealingKey

from clients.wallet.store.member_keys import WalletKeys, derive_keys
from consensus.chain.transaction import Transaction
from consensus.limits import SEALED_METADATA_BYTES
from consensus.members.vouchers import issue_card, sign_card
from consensus.primitives.encoding import encode
from consensus.primitives.keys import PrivateKey
from consensus.records.clips import ClipUpload
from consensus.records.commitments import (
    ciphertext_leaves,
    ciphertext_root,
    commitment_root,
    derive_record_id,
    frame_commitment,
)
from consensus.records.envelopes import DATA_KEY_BYTES, NONCE_BYTES, SEALED_BOX_OVERHEAD_BYTES, seal_frame
from consensus.records.metadata import RecordMetadata, compute_metadata_hash
from consensus.records.padding import pad_to
from network.sim.workload import make_material

PURPOSE, SENSOR = "care", "depth"
FRAME_BYTES = 24
CARD_VALID_MS = 24 * 3_600_000


@dataclass(slots=True)
class Person:
    """A member or robot: `words` of the wallet, the newest last, and the keys of each."""

    name: str
    role: str
    handle: bytes
    seed: int
    words: list[str] = field(default_factory=list)
    eras: list[WalletKeys] = field(default_factory=list)
    visits: list[Visit] = field(default_factory=list)

    @property
    def keys(self) -> WalletKeys:
        return self.eras[-1]

    def take_new_keys(self) -> WalletKeys:
        entropy = make_material(32, self.seed, "words", self.name, len(self.words))
        self.words.append(str(_LANGUAGE.to_mnemonic(entropy)))
        self.eras.append(derive_keys(self.words[-1]))
        return self.keys

    def register_arguments(self, chain_id: bytes, registrar: PrivateKey, now_ms: int) -> list[object]:
        """With a card of the registrar."""
        card = issue_card(
            registrar,
            chain_id=chain_id,
            handle=self.handle,
            card_secret=make_material(32, self.seed, "card", self.name),
            role=self.role,
            not_after_ms=now_ms + CARD_VALID_MS,
        )
        keys = self.keys
        public = (keys.spend.public_key, keys.view.public_key, keys.sealing_public)
        member = keys.identity.public_key
        signature = sign_card(
            card, chain_id=chain_id, member=member, spend=public[0], view=public[1], sealing=public[2]
        )
        voucher = [card.handle, card.card_public, card.role, card.not_after_ms, card.voucher_signature]
        return [*voucher, *public, signature, [PURPOSE] if self.role == "subject" else []]


_LANGUAGE = Mnemonic("english")


def make_person(seed: int, name: str, role: str) -> Person:
    person = Person(name, role, make_material(32, seed, "handle", name), seed)
    person.take_new_keys()
    return person


@dataclass(slots=True)
class Visit:
    """What its person and its robot know of a visit. `key` decides of it, `sealing` opens what was recorded.

    `trail` counts what the audit has to say, but for expiries.
    """

    number: int
    person: Person
    robot: bytes
    owner: bytes
    key: PrivateKey
    sealing: bytes
    record_ids: list[bytes] = field(default_factory=list)
    plaintexts: dict[bytes, list[bytes]] = field(default_factory=dict)
    trail: Counter[str] = field(default_factory=Counter)


@dataclass(frozen=True, slots=True)
class SealedRecord:
    """A clip, and what its record says on the chain."""

    upload: ClipUpload
    commitment_root: bytes
    ciphertext_root: bytes
    sealed_metadata: bytes
    metadata_hash: bytes
    plaintexts: list[bytes]

    def sent_by(self, call: Transaction) -> ClipUpload:
        """What custodians are sent, with the transaction of the record."""
        return structs.replace(self.upload, txid=call.txid, valid_until_ms=call.body.valid_until_ms)


def seal_from(one_time: bytes, sealing_public: bytes, plaintext: bytes) -> bytes:
    """A sealed box whose one-time key is given: libsodium draws its own, which no seed would repeat.

    It opens as any other; who knows the seed can open it too, so it is for nobody's data.
    """
    key = SealingKey(one_time)
    public = bytes(key.public_key)
    nonce = hashlib.blake2b(public + sealing_public, digest_size=NONCE_BYTES).digest()
    return public + bytes(Box(key, PublicKey(sealing_public)).encrypt(plaintext, nonce).ciphertext)


def seal_record(
    visit: Visit, sealing: bytes, frames: int, now_ms: int, index: int, previous_hash: bytes
) -> SealedRecord:
    """As a robot seals a clip, of frames of a few bytes."""
    place = (visit.person.seed, "record", visit.number, index)
    plaintexts = [make_material(FRAME_BYTES, *place, "plaintext", frame) for frame in range(frames)]
    data_keys = [make_material(DATA_KEY_BYTES, *place, "data key", frame) for frame in range(frames)]
    pairs = list(enumerate(zip(data_keys, plaintexts, strict=True)))
    leaves = [frame_commitment(key, frame, plaintext) for frame, (key, plaintext) in pairs]
    root = commitment_root(leaves)
    record_id = derive_record_id(visit.owner, root)
    texts = [
        seal_frame(key, make_material(NONCE_BYTES, *place, "nonce", frame), record_id, frame, plaintext)
        for frame, (key, plaintext) in pairs
    ]
    sealed_keys = [
        seal_from(make_material(32, *place, "one-time key", frame), sealing, key) for frame, key in enumerate(data_keys)
    ]
    metadata = RecordMetadata(
        sensor=SENSOR,
        started_at_ms=now_ms,
        ended_at_ms=now_ms + frames,
        frame_count=frames,
        index_in_visit=index,
        previous_hash=previous_hash,
        withheld=(),
        width=32,
        height=24,
    )
    padded = pad_to(encode(metadata), SEALED_METADATA_BYTES - SEALED_BOX_OVERHEAD_BYTES)
    upload = ClipUpload(
        record_id=record_id,
        txid=bytes(32),
        valid_until_ms=0,
        ciphertexts=texts,
        sealed_keys=sealed_keys,
        commitment_leaves=leaves,
        owner=visit.owner,
    )
    return SealedRecord(
        upload=upload,
        commitment_root=root,
        ciphertext_root=ciphertext_root(ciphertext_leaves(texts, sealed_keys)),
        sealed_metadata=seal_from(make_material(32, *place, "metadata"), sealing, padded),
        metadata_hash=compute_metadata_hash(metadata),
        plaintexts=plaintexts,
    )

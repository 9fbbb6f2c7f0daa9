"""Clips on the wire: what a robot uploads to a custodian and what an owner gets back."""

from __future__ import annotations

from consensus.errors import BlockRobotError
from consensus.limits import CIPHERTEXT_MAX_BYTES, CLIP_FRAMES_MAX_COUNT, CLIP_SIZE_MAX_BYTES
from consensus.primitives.encoding import Wire
from consensus.primitives.hashing import HASH_SIZE_BYTES, sha256
from consensus.records.commitments import ciphertext_leaf, ciphertext_root, commitment_root
from consensus.records.envelopes import NONCE_BYTES, RECORD_ID_BYTES, SEALED_KEY_BYTES, TAG_BYTES


class ClipUpload(Wire, frozen=True):
    """One clip for a custodian: three lists of equal length, a place for each frame.

    `txid` is the record's transaction and `valid_until_ms` its expiry; `sealed_keys` are data keys sealed to the owner,
    whose visit is the one under `owner` (33 bytes).
    """

    record_id: bytes
    txid: bytes
    valid_until_ms: int
    ciphertexts: list[bytes]
    sealed_keys: list[bytes]
    commitment_leaves: list[bytes]
    owner: bytes = b""

    @property
    def size_bytes(self) -> int:
        """The bytes of its ciphertexts and keys, which a quota counts."""
        return sum(map(len, self.ciphertexts)) + sum(map(len, self.sealed_keys))


class FrameDownload(Wire, frozen=True):
    """One frame as a custodian holds it. An erased one keeps its place, with empty bytes."""

    index: int
    erased: bool
    ciphertext: bytes
    sealed_key: bytes


class ClipDownload(Wire, frozen=True):
    """One clip from a custodian: every frame in order, and the leaves under both roots on the chain."""

    record_id: bytes
    txid: bytes
    frames: list[FrameDownload]
    commitment_leaves: list[bytes]
    ciphertext_leaves: list[bytes]


def _refuse(detail: str) -> BlockRobotError:
    return BlockRobotError("UPLOAD_INVALID", detail)


def _check_frame(index: int, ciphertext: bytes, sealed_key: bytes) -> None:
    if not NONCE_BYTES + TAG_BYTES < len(ciphertext) <= CIPHERTEXT_MAX_BYTES:
        raise _refuse(f"The ciphertext of frame {index} has {len(ciphertext)} bytes.")
    if len(sealed_key) != SEALED_KEY_BYTES:
        raise _refuse(f"The sealed key of frame {index} has {len(sealed_key)} bytes instead of {SEALED_KEY_BYTES}.")


def _check_leaves(leaves: list[bytes]) -> None:
    if any(len(leaf) != HASH_SIZE_BYTES for leaf in leaves):
        raise _refuse("A leaf does not have 32 bytes.")


def check_clip_upload(upload: ClipUpload) -> None:
    """Check sizes and counts of an upload against the limits of the protocol. Raises UPLOAD_INVALID."""
    count = len(upload.ciphertexts)
    if len(upload.record_id) != RECORD_ID_BYTES or len(upload.txid) != HASH_SIZE_BYTES:
        raise _refuse("A record id has 16 bytes and a txid 32.")
    if not 1 <= count <= CLIP_FRAMES_MAX_COUNT:
        raise _refuse(f"A clip has 1 to {CLIP_FRAMES_MAX_COUNT} frames, not {count}.")
    if len(upload.sealed_keys) != count or len(upload.commitment_leaves) != count:
        raise _refuse("The numbers of ciphertexts, sealed keys and commitment leaves differ.")
    if upload.valid_until_ms < 0:
        raise _refuse("The expiry of the transaction is negative.")
    for index, (text, key) in enumerate(zip(upload.ciphertexts, upload.sealed_keys, strict=True)):
        _check_frame(index, text, key)
    if sum(map(len, upload.ciphertexts)) > CLIP_SIZE_MAX_BYTES:
        raise _refuse("The clip is larger than 16 MiB.")
    _check_leaves(upload.commitment_leaves)


def check_clip_download(download: ClipDownload, commitment_root_: bytes, ciphertext_root_: bytes) -> list[int]:
    """Check a download against the two roots of its record and return the indexes of corrupted frames.

    Raises UPLOAD_INVALID for a wrong form, PROOF_INVALID if the leaves do not lead to the roots. A frame is corrupted
    if its bytes do not make its ciphertext leaf; what it shows is then still to be checked with its data key.
    """
    count = len(download.frames)
    if not 1 <= count <= CLIP_FRAMES_MAX_COUNT or [frame.index for frame in download.frames] != list(range(count)):
        raise _refuse("The frames of the clip are not complete and in order.")
    if len(download.commitment_leaves) != count or len(download.ciphertext_leaves) != count:
        raise _refuse("The numbers of frames and leaves differ.")
    _check_leaves(download.commitment_leaves)
    _check_leaves(download.ciphertext_leaves)
    if commitment_root(download.commitment_leaves) != commitment_root_:
        raise BlockRobotError("PROOF_INVALID", "The commitment leaves do not lead to the record's root.")
    if ciphertext_root(download.ciphertext_leaves) != ciphertext_root_:
        raise BlockRobotError("PROOF_INVALID", "The ciphertext leaves do not lead to the record's root.")
    return [
        frame.index
        for frame, leaf in zip(download.frames, download.ciphertext_leaves, strict=True)
        if not frame.erased and ciphertext_leaf(frame.index, sha256(frame.ciphertext), sha256(frame.sealed_key)) != leaf
    ]

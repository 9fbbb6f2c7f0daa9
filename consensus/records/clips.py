"""Clip messages: robot uploads and owner downloads."""

from __future__ import annotations

from typing import Annotated, TypeVar

from msgspec import Meta

from consensus.errors import BlockRobotError
from consensus.limits import CIPHERTEXT_MAX_BYTES, CLIP_FRAMES_MAX_COUNT, CLIP_SIZE_MAX_BYTES
from consensus.primitives.encoding import Wire
from consensus.primitives.hashing import HASH_SIZE_BYTES, sha256
from consensus.records.commitments import ciphertext_leaf, ciphertext_root, commitment_root, derive_record_id
from consensus.records.envelopes import NONCE_BYTES, SEALED_KEY_BYTES, TAG_BYTES

T = TypeVar("T")
OfFrames = Annotated[list[T], Meta(max_length=CLIP_FRAMES_MAX_COUNT)]
"""One place for each frame; longer lists are refused before they are read."""


class ClipUpload(Wire, frozen=True):
    """A clip for a custodian: three lists of equal length, one place per frame.

    `record_id` is that of `derive_record_id`, `txid` the record's transaction, `valid_until_ms` its expiry; `sealed_keys`
    are sealed to the owner of visit `owner` (33 bytes).
    """

    record_id: bytes
    txid: bytes
    valid_until_ms: int
    ciphertexts: OfFrames[bytes]
    sealed_keys: OfFrames[bytes]
    commitment_leaves: OfFrames[bytes]
    owner: bytes

    @property
    def size_bytes(self) -> int:
        """Return bytes of ciphertexts and keys, as quotas count."""
        return sum(map(len, self.ciphertexts)) + sum(map(len, self.sealed_keys))


class FrameDownload(Wire, frozen=True):
    """One frame of a custodian; empty bytes if erased."""

    index: int
    erased: bool
    ciphertext: bytes
    sealed_key: bytes


class ClipDownload(Wire, frozen=True):
    """A custodian's clip: frames in order and leaves under both roots."""

    record_id: bytes
    txid: bytes
    frames: OfFrames[FrameDownload]
    commitment_leaves: OfFrames[bytes]
    ciphertext_leaves: OfFrames[bytes]


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
    """Raises UPLOAD_INVALID."""
    count = len(upload.ciphertexts)
    if len(upload.txid) != HASH_SIZE_BYTES:
        raise _refuse("A txid has 32 bytes.")
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
    if upload.record_id != derive_record_id(upload.owner, commitment_root(upload.commitment_leaves)):
        raise _refuse("The record id does not follow from the visit's owner key and the commitments.")


def check_clip_download(download: ClipDownload, commitment_root_: bytes, ciphertext_root_: bytes) -> list[int]:
    """Check against both roots; return frames not matching their ciphertext leaf. Plaintexts remain unchecked.

    Raises UPLOAD_INVALID, PROOF_INVALID.
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

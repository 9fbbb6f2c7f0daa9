"""Clips on the wire: what an upload must be, and what a download proves."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from consensus.errors import BlockRobotError
from consensus.limits import CIPHERTEXT_MAX_BYTES, CLIP_FRAMES_MAX_COUNT
from consensus.primitives.encoding import decode, encode
from consensus.primitives.hashing import sha256
from consensus.records.clips import ClipDownload, ClipUpload, FrameDownload, check_clip_download, check_clip_upload
from consensus.records.commitments import ciphertext_leaves, ciphertext_root, commitment_root, derive_record_id

OWNER = bytes(range(33))
COMMITMENTS = [sha256(bytes((index,))) for index in range(3)]
UPLOAD = ClipUpload(
    record_id=derive_record_id(OWNER, commitment_root(COMMITMENTS)),
    txid=bytes(32),
    valid_until_ms=1_800_000_000_000,
    ciphertexts=[bytes((index,)) * 1064 for index in range(3)],
    sealed_keys=[bytes((index,)) * 80 for index in range(3)],
    commitment_leaves=COMMITMENTS,
    owner=OWNER,
)
LEAVES = ciphertext_leaves(UPLOAD.ciphertexts, UPLOAD.sealed_keys)
ROOTS = commitment_root(UPLOAD.commitment_leaves), ciphertext_root(LEAVES)
DOWNLOAD = ClipDownload(
    record_id=UPLOAD.record_id,
    txid=UPLOAD.txid,
    frames=[
        FrameDownload(index, False, text, key)
        for index, (text, key) in enumerate(zip(UPLOAD.ciphertexts, UPLOAD.sealed_keys, strict=True))
    ],
    commitment_leaves=UPLOAD.commitment_leaves,
    ciphertext_leaves=LEAVES,
)


def code_of(action, *arguments: Any) -> str:
    with pytest.raises(BlockRobotError) as refusal:
        action(*arguments)
    return refusal.value.code


def test_both_travel_in_one_form() -> None:
    check_clip_upload(UPLOAD)
    assert decode(encode(UPLOAD), ClipUpload) == UPLOAD
    assert decode(encode(DOWNLOAD), ClipDownload) == DOWNLOAD


@pytest.mark.parametrize(
    "changes",
    [
        {"record_id": bytes(15)},
        {"record_id": bytes(16)},
        {"owner": bytes(33)},
        {"commitment_leaves": COMMITMENTS[::-1]},
        {"txid": bytes(31)},
        {"valid_until_ms": -1},
        {"ciphertexts": UPLOAD.ciphertexts[:2]},
        {"sealed_keys": UPLOAD.sealed_keys[:2]},
        {"commitment_leaves": UPLOAD.commitment_leaves * 2},
        {"ciphertexts": [b""] * 3},
        {"ciphertexts": [bytes(40)] * 3},
        {"ciphertexts": [bytes(CIPHERTEXT_MAX_BYTES + 1)] * 3},
        {"sealed_keys": [bytes(79)] * 3},
        {"commitment_leaves": [bytes(33)] * 3},
        {"ciphertexts": [], "sealed_keys": [], "commitment_leaves": []},
    ],
)
def test_an_upload_of_other_sizes_or_counts_is_refused(changes: dict[str, Any]) -> None:
    assert code_of(check_clip_upload, msgspec.structs.replace(UPLOAD, **changes)) == "UPLOAD_INVALID"


def upload_of(frames: int, size: int) -> ClipUpload:
    return msgspec.structs.replace(
        UPLOAD,
        record_id=derive_record_id(OWNER, commitment_root([bytes(32)] * frames)),
        ciphertexts=[bytes(size)] * frames,
        sealed_keys=[bytes(80)] * frames,
        commitment_leaves=[bytes(32)] * frames,
    )


def test_a_clip_is_bounded_in_frames_and_in_bytes() -> None:
    check_clip_upload(upload_of(CLIP_FRAMES_MAX_COUNT, 1064))
    check_clip_upload(upload_of(16, CIPHERTEXT_MAX_BYTES))
    assert code_of(check_clip_upload, upload_of(CLIP_FRAMES_MAX_COUNT + 1, 1064)) == "UPLOAD_INVALID"
    assert code_of(check_clip_upload, upload_of(17, CIPHERTEXT_MAX_BYTES)) == "UPLOAD_INVALID"


def with_frame(frame: FrameDownload) -> ClipDownload:
    frames = list(DOWNLOAD.frames)
    frames[frame.index] = frame
    return msgspec.structs.replace(DOWNLOAD, frames=frames)


def test_a_download_names_the_frames_that_are_corrupted_and_no_erased_one() -> None:
    assert check_clip_download(DOWNLOAD, *ROOTS) == []
    frame = DOWNLOAD.frames[1]
    text = msgspec.structs.replace(frame, ciphertext=frame.ciphertext[:-1] + b"\xff")
    key = msgspec.structs.replace(frame, sealed_key=b"\xff" + frame.sealed_key[1:])
    assert check_clip_download(with_frame(text), *ROOTS) == [1]
    assert check_clip_download(with_frame(key), *ROOTS) == [1]
    assert check_clip_download(with_frame(FrameDownload(2, True, b"", b"")), *ROOTS) == []
    first, second = DOWNLOAD.frames[:2]
    frames = [msgspec.structs.replace(second, index=0), msgspec.structs.replace(first, index=1), DOWNLOAD.frames[2]]
    assert check_clip_download(msgspec.structs.replace(DOWNLOAD, frames=frames), *ROOTS) == [0, 1]


@pytest.mark.parametrize("leaves", ["commitment_leaves", "ciphertext_leaves"])
def test_leaves_of_another_record_prove_nothing(leaves: str) -> None:
    other = msgspec.structs.replace(DOWNLOAD, **{leaves: [bytes(32)] * 3})
    assert code_of(check_clip_download, other, *ROOTS) == "PROOF_INVALID"


@pytest.mark.parametrize(
    "changes",
    [
        {"frames": DOWNLOAD.frames[:2]},
        {"frames": []},
        {"frames": DOWNLOAD.frames[::-1]},
        {"commitment_leaves": DOWNLOAD.commitment_leaves[:2]},
        {"ciphertext_leaves": [bytes(31)] * 3},
    ],
)
def test_a_download_that_is_not_complete_is_refused(changes: dict[str, Any]) -> None:
    assert code_of(check_clip_download, msgspec.structs.replace(DOWNLOAD, **changes), *ROOTS) == "UPLOAD_INVALID"

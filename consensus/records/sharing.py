"""Sharing messages: data keys sealed to the grantee and encrypted under T, which any two custodians' parts restore."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Annotated

from msgspec import Meta

from consensus.errors import BlockRobotError
from consensus.limits import CIPHERTEXT_MAX_BYTES, CLIP_FRAMES_MAX_COUNT
from consensus.primitives.encoding import Wire, decode, encode
from consensus.primitives.hashing import HASH_SIZE_BYTES, sha256, tagged_hash
from consensus.primitives.keys import PUBLIC_KEY_SIZE_BYTES, PrivateKey
from consensus.records.clips import ClipDownload, OfFrames
from consensus.records.commitments import ciphertext_leaf, ciphertext_root, commitment_root
from consensus.records.envelopes import DATA_KEY_BYTES, RECORD_ID_BYTES, open_bytes, open_sealed, seal_bytes, seal_to
from consensus.records.owner_keys import VisitKeys, derive_owner_key, open_visit_keys, scan_announcement

SHARE_KEY_BYTES = 32
GRANT_SALT_BYTES = 32
HANDLE_BYTES = 32
GRANT_RECORDS_MAX_COUNT = 64
GRANT_STEP_MS = 300_000
"""A grant ends on a full five minutes, as records are placed in time: an exact end would tell grants apart."""
GRANT_MAX_MS = 366 * 24 * 3600 * 1000
PACKAGE_MAX_BYTES = 4096
PARTS_MAX_COUNT = 64
GRANTEE_ROLES = ("officer", "staff")
"""The roles of members with whom records may be shared."""

_MEMBER = "blockrobot/grant-member"
_SALT_TAG = "blockrobot/grant-salt"
_PACKAGE_PLACE = 0


class KeyPart(Wire, frozen=True):
    """A custodian's 32-byte part of T, paired with `custodian` (33 bytes); T itself if alone."""

    custodian: bytes
    value: bytes


class GrantUpload(Wire, frozen=True):
    """A record's package and one custodian's parts; `grant_txid` is the grant id."""

    grant_txid: bytes
    valid_until_ms: int
    record_id: bytes
    package: bytes
    parts: Annotated[list[KeyPart], Meta(max_length=PARTS_MAX_COUNT)]


class SharedRequest(Wire, frozen=True):
    """A grantee's request under a final access, proving `member_hash`; without `with_frames`, package and parts only."""

    record_id: bytes
    access_id: bytes
    handle: bytes
    salt: bytes
    with_frames: bool


class SharedFrame(Wire, frozen=True):
    """A grantee's frame, with the owner-sealed key's SHA-256 for the leaf."""

    index: int
    erased: bool
    ciphertext: bytes
    sealed_key_hash: bytes


class SharedDownload(Wire, frozen=True):
    """A custodian's (33 bytes) shared clip: frames, leaves, package and parts."""

    record_id: bytes
    custodian: bytes
    frames: OfFrames[SharedFrame]
    commitment_leaves: OfFrames[bytes]
    ciphertext_leaves: OfFrames[bytes]
    package: bytes
    parts: Annotated[list[KeyPart], Meta(max_length=PARTS_MAX_COUNT)]


class _FrameKey(Wire, frozen=True):
    index: int
    key: bytes


class _KeyPack(Wire, frozen=True):
    grantee: bytes
    record_id: bytes
    keys: OfFrames[_FrameKey]


# The grantee's one-time key


def open_grant_keys(ephemeral_secret: bytes, view: bytes, spend: bytes, *, chain_id: bytes, owner: bytes) -> VisitKeys:
    """Return a grant's one-time keys: result `owner` is G, argument `owner` the visit's O.

    `view` and `spend` are the grantee's; `ephemeral_secret` is 32 fresh bytes to forget. Raises KEY_INVALID.
    """
    return open_visit_keys(ephemeral_secret, view, spend, chain_id=chain_id, robot=owner)


def scan_grant(
    view: PrivateKey, spend_public: bytes, ephemeral: bytes, view_tag: int, *, chain_id: bytes, owner: bytes
) -> bytes | None:
    """Return the candidate key G, to compare with the grant's; None if not ours."""
    return scan_announcement(view, spend_public, ephemeral, view_tag, chain_id=chain_id, robot=owner)


def derive_grantee_key(
    spend: PrivateKey, view: PrivateKey, ephemeral: bytes, *, chain_id: bytes, owner: bytes
) -> PrivateKey:
    """Derive G's private key; it is never stored. Raises KEY_INVALID."""
    return derive_owner_key(spend, view, ephemeral, chain_id=chain_id, robot=owner)


def hash_grant_member(salt: bytes, handle: bytes) -> bytes:
    """Return the grantee's 32-byte on-chain hash. Raises VALUE_INVALID."""
    if len(salt) != GRANT_SALT_BYTES or len(handle) != HANDLE_BYTES:
        raise BlockRobotError("VALUE_INVALID", "The salt of a grant and a handle have 32 bytes each.")
    return tagged_hash(_MEMBER, salt, handle)


# The key T and its parts


def _xor(left: bytes, right: bytes) -> bytes:
    return bytes(a ^ b for a, b in zip(left, right, strict=True))


def count_masks(custodian_count: int) -> int:
    """Return the number of 32-byte masks: one per custodian pair."""
    return custodian_count * (custodian_count - 1) // 2


def split_share_key(
    share_key: bytes, custodians: Sequence[bytes], masks: Sequence[bytes]
) -> dict[bytes, list[KeyPart]]:
    """Split T: any two custodians' parts restore it, one's are random.

    `custodians` are distinct 33-byte keys, `masks` `count_masks` fresh 32-byte values; a single custodian gets T.
    Raises VALUE_INVALID.
    """
    sizes = [len(share_key), *map(len, masks)]
    if any(size != SHARE_KEY_BYTES for size in sizes) or len(masks) != count_masks(len(custodians)):
        raise BlockRobotError("VALUE_INVALID", "The key and each mask have 32 bytes, and each pair takes one mask.")
    known = sorted(set(custodians))
    if not known or len(known) != len(custodians) or any(len(key) != PUBLIC_KEY_SIZE_BYTES for key in known):
        raise BlockRobotError("VALUE_INVALID", "Custodians are member keys of 33 bytes, each named once.")
    if len(known) == 1:
        return {known[0]: [KeyPart(known[0], share_key)]}
    parts: dict[bytes, list[KeyPart]] = {key: [] for key in known}
    for (first, second), mask in zip(combinations(known, 2), masks, strict=True):
        parts[first].append(KeyPart(second, mask))
        parts[second].append(KeyPart(first, _xor(share_key, mask)))
    return parts


def join_parts(held: Mapping[bytes, Sequence[KeyPart]]) -> list[bytes]:
    """Return candidates for T, several if a custodian lies; `held` is keyed by proven sender, parts already checked."""
    of_pair = {(holder, part.custodian): part.value for holder, parts in held.items() for part in parts}
    found: list[bytes] = []
    for (holder, other), value in sorted(of_pair.items()):
        if holder == other:
            joined = value
        elif holder < other and (other, holder) in of_pair:
            joined = _xor(value, of_pair[other, holder])
        else:
            continue
        if joined not in found:
            found.append(joined)
    return found


# The package


def seal_package(
    share_key: bytes, nonce: bytes, sealing: bytes, *, grantee: bytes, record_id: bytes, keys: Mapping[int, bytes]
) -> bytes:
    """Seal data keys by frame to the grantee's X, encrypted under T.

    `sealing` is their public key, `grantee` G, `nonce` 24 fresh bytes. Raises VALUE_INVALID, KEY_INVALID.
    """
    sized = all(len(key) == DATA_KEY_BYTES and 0 <= index < CLIP_FRAMES_MAX_COUNT for index, key in keys.items())
    if not keys or not sized or len(grantee) != PUBLIC_KEY_SIZE_BYTES:
        raise BlockRobotError("VALUE_INVALID", "A package holds 1 to 64 data keys of 32 bytes, and names its grantee.")
    pack = _KeyPack(grantee, record_id, [_FrameKey(index, key) for index, key in sorted(keys.items())])
    return seal_bytes(share_key, nonce, record_id, _PACKAGE_PLACE, seal_to(sealing, encode(pack)))


def open_package(
    candidates: Sequence[bytes], sealing_private: bytes, package: bytes, *, grantee: bytes, record_id: bytes
) -> dict[int, bytes]:
    """Open a package with the first fitting candidate; returned keys still need checking per frame.

    Raises GRANT_PARTS_MISSING without candidates, ENVELOPE_INVALID.
    """
    if not candidates:
        raise BlockRobotError("GRANT_PARTS_MISSING")
    for share_key in candidates:
        try:
            sealed = open_bytes(share_key, record_id, _PACKAGE_PLACE, package)
        except BlockRobotError:
            continue
        try:
            pack = decode(open_sealed(sealing_private, sealed), _KeyPack)
        except BlockRobotError:
            raise BlockRobotError("ENVELOPE_INVALID", "The package was not made for this wallet.") from None
        if (pack.grantee, pack.record_id) != (grantee, record_id):
            raise BlockRobotError("ENVELOPE_INVALID", "The package was made for another grant or record.")
        return {entry.index: entry.key for entry in pack.keys}
    raise BlockRobotError("ENVELOPE_INVALID", "No two custodians' parts join to the key of this package.")


# What goes over the wire


def _refuse(detail: str) -> BlockRobotError:
    return BlockRobotError("UPLOAD_INVALID", detail)


def _check_parts(parts: Sequence[KeyPart]) -> None:
    sized = all(len(p.custodian) == PUBLIC_KEY_SIZE_BYTES and len(p.value) == SHARE_KEY_BYTES for p in parts)
    if not 1 <= len(parts) <= PARTS_MAX_COUNT or not sized:
        raise _refuse("A custodian gets 1 to 64 parts: a custodian's key of 33 bytes and a value of 32 each.")
    if len({part.custodian for part in parts}) != len(parts):
        raise _refuse("Two parts are for the same pair of custodians.")


def check_grant_upload(upload: GrantUpload) -> None:
    """Raises UPLOAD_INVALID."""
    if len(upload.record_id) != RECORD_ID_BYTES or len(upload.grant_txid) != HASH_SIZE_BYTES:
        raise _refuse("A record id has 16 bytes and a txid 32.")
    if not 0 < len(upload.package) <= PACKAGE_MAX_BYTES:
        raise _refuse(f"A package has at most {PACKAGE_MAX_BYTES} bytes.")
    if upload.valid_until_ms < 0:
        raise _refuse("The expiry of the transaction is negative.")
    _check_parts(upload.parts)


def check_shared_parts(download: SharedDownload) -> None:
    """Raises UPLOAD_INVALID."""
    if not 0 < len(download.package) <= PACKAGE_MAX_BYTES:
        raise _refuse(f"A package has 1 to {PACKAGE_MAX_BYTES} bytes.")
    _check_parts(download.parts)


def build_shared_download(
    clip: ClipDownload, custodian: bytes, package: bytes, parts: Sequence[KeyPart], *, with_frames: bool
) -> SharedDownload:
    frames = [
        SharedFrame(
            index=frame.index,
            erased=frame.erased,
            ciphertext=frame.ciphertext,
            sealed_key_hash=b"" if frame.erased else sha256(frame.sealed_key),
        )
        for frame in clip.frames
    ]
    return SharedDownload(
        record_id=clip.record_id,
        custodian=custodian,
        frames=frames if with_frames else [],
        commitment_leaves=clip.commitment_leaves if with_frames else [],
        ciphertext_leaves=clip.ciphertext_leaves if with_frames else [],
        package=package,
        parts=list(parts),
    )


def check_shared_download(download: SharedDownload, commitment_root_: bytes, ciphertext_root_: bytes) -> list[int]:
    """Return corrupted frame indexes, checking against both roots. Raises UPLOAD_INVALID, PROOF_INVALID."""
    count = len(download.frames)
    if not 1 <= count <= CLIP_FRAMES_MAX_COUNT or [frame.index for frame in download.frames] != list(range(count)):
        raise _refuse("The frames of the clip are not complete and in order.")
    if any(len(frame.ciphertext) > CIPHERTEXT_MAX_BYTES for frame in download.frames):
        raise _refuse("A frame of the clip is too large.")
    leaves = [*download.commitment_leaves, *download.ciphertext_leaves]
    if len(leaves) != 2 * count or len(download.ciphertext_leaves) != count or any(len(leaf) != 32 for leaf in leaves):
        raise _refuse("The numbers of frames and leaves differ, or a leaf does not have 32 bytes.")
    if commitment_root(download.commitment_leaves) != commitment_root_:
        raise BlockRobotError("PROOF_INVALID", "The commitment leaves do not lead to the record's root.")
    if ciphertext_root(download.ciphertext_leaves) != ciphertext_root_:
        raise BlockRobotError("PROOF_INVALID", "The ciphertext leaves do not lead to the record's root.")
    return [
        frame.index
        for frame, leaf in zip(download.frames, download.ciphertext_leaves, strict=True)
        if not frame.erased and ciphertext_leaf(frame.index, sha256(frame.ciphertext), frame.sealed_key_hash) != leaf
    ]


def derive_grant_salt(private: PrivateKey, public: bytes, *, chain_id: bytes, owner: bytes) -> bytes:
    """Return the 32-byte salt of a grant of visit `owner`, which opens the grantee's hash to custodians.

    From ephemeral secret and public view key, or private view key and on-chain ephemeral. Raises KEY_INVALID,
    VALUE_INVALID.
    """
    if len(chain_id) != HASH_SIZE_BYTES or len(owner) != PUBLIC_KEY_SIZE_BYTES:
        raise BlockRobotError("VALUE_INVALID", "A chain id has 32 bytes and an owner key 33.")
    return tagged_hash(_SALT_TAG, chain_id, owner, private.shared_point(public))

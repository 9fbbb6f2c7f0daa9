"""What owner, grantee and custodians exchange when a record is shared: one-time keys, packages of data keys, split keys.

The owner seals the data
keys of a record to the grantee's X and closes that with a key T of its own; T is split so that any two custodians'
parts join to it and one's say nothing. Random bytes come from the caller.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

from consensus.errors import BlockRobotError
from consensus.limits import CIPHERTEXT_MAX_BYTES, CLIP_FRAMES_MAX_COUNT
from consensus.primitives.encoding import Wire, decode, encode
from consensus.primitives.hashing import HASH_SIZE_BYTES, sha256, tagged_hash
from consensus.primitives.keys import PUBLIC_KEY_SIZE_BYTES, PrivateKey
from consensus.records.clips import ClipDownload
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
_PACKAGE_PLACE = 0


class KeyPart(Wire, frozen=True):
    """What one custodian holds of T for the pair that it makes with `custodian` (33 bytes): a value of 32 bytes.

    A custodian that is the only one of the network holds T itself, under its own key.
    """

    custodian: bytes
    value: bytes


class GrantUpload(Wire, frozen=True):
    """One record of a grant for one custodian: the package, and this custodian's parts of T.

    `grant_txid` is the grant's transaction and so its id, `valid_until_ms` the expiry of that transaction.
    """

    grant_txid: bytes
    valid_until_ms: int
    record_id: bytes
    package: bytes
    parts: list[KeyPart]


class SharedRequest(Wire, frozen=True):
    """What a grantee asks a custodian under a final access of hers: a record, and who she is for `member_hash`.

    Without `with_frames` the answer has package and parts only, which is all that is needed of a second custodian.
    """

    record_id: bytes
    access_id: bytes
    handle: bytes
    salt: bytes
    with_frames: bool


class SharedFrame(Wire, frozen=True):
    """One frame for a grantee: not the key that is sealed to the owner, only its SHA-256, which makes the leaf."""

    index: int
    erased: bool
    ciphertext: bytes
    sealed_key_hash: bytes


class SharedDownload(Wire, frozen=True):
    """A shared clip from one custodian (33 bytes): frames, leaves under the roots on the chain, package and parts."""

    record_id: bytes
    custodian: bytes
    frames: list[SharedFrame]
    commitment_leaves: list[bytes]
    ciphertext_leaves: list[bytes]
    package: bytes
    parts: list[KeyPart]


class _FrameKey(Wire, frozen=True):
    index: int
    key: bytes


class _KeyPack(Wire, frozen=True):
    grantee: bytes
    record_id: bytes
    keys: list[_FrameKey]


# The grantee's one-time key


def open_grant_keys(ephemeral_secret: bytes, view: bytes, spend: bytes, *, chain_id: bytes, owner: bytes) -> VisitKeys:
    """Return the one-time keys of a grant: `owner` of the result is the grantee's key G. `owner` is the visit's O.

    `view` and `spend` are the grantee's; `ephemeral_secret` is 32 fresh random bytes that the caller forgets. Raises
    KEY_INVALID if a key is no point of the curve.
    """
    return open_visit_keys(ephemeral_secret, view, spend, chain_id=chain_id, robot=owner)


def scan_grant(
    view: PrivateKey, spend_public: bytes, ephemeral: bytes, view_tag: int, *, chain_id: bytes, owner: bytes
) -> bytes | None:
    """Return the key G that this grant has if it is ours, or None if it cannot be; compare with the granted one."""
    return scan_announcement(view, spend_public, ephemeral, view_tag, chain_id=chain_id, robot=owner)


def derive_grantee_key(
    spend: PrivateKey, view: PrivateKey, ephemeral: bytes, *, chain_id: bytes, owner: bytes
) -> PrivateKey:
    """Return the private key of a grant's G. It is derived when needed and never stored. Raises KEY_INVALID."""
    return derive_owner_key(spend, view, ephemeral, chain_id=chain_id, robot=owner)


def hash_grant_member(salt: bytes, handle: bytes) -> bytes:
    """Return the 32 bytes that stand on the chain for the grantee. Raises VALUE_INVALID for wrong sizes."""
    if len(salt) != GRANT_SALT_BYTES or len(handle) != HANDLE_BYTES:
        raise BlockRobotError("VALUE_INVALID", "The salt of a grant and a handle have 32 bytes each.")
    return tagged_hash(_MEMBER, salt, handle)


# The key T and its parts


def _xor(left: bytes, right: bytes) -> bytes:
    return bytes(a ^ b for a, b in zip(left, right, strict=True))


def count_masks(custodian_count: int) -> int:
    """Return how many random masks of 32 bytes `split_share_key` takes: one for each pair of custodians."""
    return custodian_count * (custodian_count - 1) // 2


def split_share_key(
    share_key: bytes, custodians: Sequence[bytes], masks: Sequence[bytes]
) -> dict[bytes, list[KeyPart]]:
    """Return each custodian's parts of T: any two custodians' join to it, one's alone are random bytes.

    `custodians` are member keys of 33 bytes, each once; `masks` as many fresh random values of 32 bytes as `count_masks`
    says. With a single custodian its part is T itself. Raises VALUE_INVALID.
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
    """Return what the parts of these custodians join to, each key once: T, if none of them lies.

    `held` is by the proven key of whoever gave them, not by the key that an answer claims, and of checked form
    (`check_shared_parts`). Then a custodian whose parts are wrong spoils only the pairs that it is in, so with three
    there may be several.
    """
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
    """Return the package of a record: its data keys by frame, sealed to the grantee's X, closed with T.

    `sealing` is her public sealing key, `grantee` her one-time key G, `nonce` 24 fresh random bytes. Raises VALUE_INVALID,
    KEY_INVALID.
    """
    sized = all(len(key) == DATA_KEY_BYTES and 0 <= index < CLIP_FRAMES_MAX_COUNT for index, key in keys.items())
    if not keys or not sized or len(grantee) != PUBLIC_KEY_SIZE_BYTES:
        raise BlockRobotError("VALUE_INVALID", "A package holds 1 to 64 data keys of 32 bytes, and names its grantee.")
    pack = _KeyPack(grantee, record_id, [_FrameKey(index, key) for index, key in sorted(keys.items())])
    return seal_bytes(share_key, nonce, record_id, _PACKAGE_PLACE, seal_to(sealing, encode(pack)))


def open_package(
    candidates: Sequence[bytes], sealing_private: bytes, package: bytes, *, grantee: bytes, record_id: bytes
) -> dict[int, bytes]:
    """Return the data keys of a record by frame, with the first of these keys (`join_parts`) that opens the package.

    Raises GRANT_PARTS_MISSING if there is no key to try, ENVELOPE_INVALID if none opens it or it was made for another
    grantee or record. Whether the keys open what the robot committed to is for the caller to check, frame by frame.
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
    """Check sizes and counts of an upload. Raises UPLOAD_INVALID."""
    if len(upload.record_id) != RECORD_ID_BYTES or len(upload.grant_txid) != HASH_SIZE_BYTES:
        raise _refuse("A record id has 16 bytes and a txid 32.")
    if not 0 < len(upload.package) <= PACKAGE_MAX_BYTES:
        raise _refuse(f"A package has at most {PACKAGE_MAX_BYTES} bytes.")
    if upload.valid_until_ms < 0:
        raise _refuse("The expiry of the transaction is negative.")
    _check_parts(upload.parts)


def check_shared_parts(download: SharedDownload) -> None:
    """Check sizes and counts of package and parts in a download, before they are used. Raises UPLOAD_INVALID."""
    if not 0 < len(download.package) <= PACKAGE_MAX_BYTES:
        raise _refuse(f"A package has 1 to {PACKAGE_MAX_BYTES} bytes.")
    _check_parts(download.parts)


def build_shared_download(
    clip: ClipDownload, custodian: bytes, package: bytes, parts: Sequence[KeyPart], *, with_frames: bool
) -> SharedDownload:
    """Return what a grantee gets of a clip. The keys that are sealed to the owner stay behind."""
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
    """Check a download with frames against the two roots of its record; return the indexes of corrupted frames.

    Raises UPLOAD_INVALID for a wrong form, PROOF_INVALID if the leaves do not lead to the roots.
    """
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

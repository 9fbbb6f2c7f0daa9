"""What an owner's wallet makes for one grantee, and the grantee finds again. Must never name her, nor draw randomness.

The grantee's key on the chain is a one-time key, made by the scheme of visits with the visit's owner key in the robot's
place: she finds it by scanning grants, and nobody else can tell for whom it is. The salt of her handle follows from the
same secret, so that she can show custodians that a grant is hers. What opens the pictures is a pack of data keys, sealed
to her sealing key and then, as a package, under a key of which no single custodian has anything (`sharing`).
"""

from __future__ import annotations

from dataclasses import dataclass

from consensus.errors import BlockRobotError
from consensus.limits import CLIP_FRAMES_MAX_COUNT
from consensus.primitives.encoding import Wire, decode, encode
from consensus.primitives.hashing import tagged_hash
from consensus.primitives.keys import PrivateKey
from consensus.records.envelopes import (
    DATA_KEY_BYTES,
    RECORD_ID_BYTES,
    open_bytes,
    open_sealed,
    seal_bytes,
    seal_to,
)
from consensus.records.owner_keys import derive_owner_key, open_visit_keys, scan_announcement

HANDLE_BYTES = 32
_SALT_TAG = "blockrobot/grant-salt"
_MEMBER_TAG = "blockrobot/grant-member"
_PACKAGE_PLACE = 0


@dataclass(frozen=True, slots=True)
class GrantKeys:
    """What a grant is made with: its key G, the ephemeral R (33 bytes each), the view tag; the salt is not on the chain."""

    grantee: bytes
    ephemeral: bytes
    view_tag: int
    salt: bytes


class KeyPack(Wire, frozen=True):
    """The data keys of one record's frames, by index, ascending; a frame that was erased has none."""

    record_id: bytes
    indexes: list[int]
    data_keys: list[bytes]


def _salt(private: PrivateKey, public: bytes, chain_id: bytes, owner: bytes) -> bytes:
    return tagged_hash(_SALT_TAG, chain_id, owner, private.shared_point(public))


def make_grant_keys(ephemeral_secret: bytes, view: bytes, spend: bytes, *, chain_id: bytes, owner: bytes) -> GrantKeys:
    """Return the keys of a new grant by the visit `owner`. `ephemeral_secret` is 32 fresh random bytes, then forgotten.

    Raises KEY_INVALID if a key of the grantee is no point of the curve.
    """
    made = open_visit_keys(ephemeral_secret, view, spend, chain_id=chain_id, robot=owner)
    salt = _salt(PrivateKey(ephemeral_secret), view, chain_id, owner)
    return GrantKeys(made.owner, made.ephemeral, made.view_tag, salt)


def is_grant_for(
    view: PrivateKey, spend: bytes, *, grantee: bytes, ephemeral: bytes, view_tag: int, chain_id: bytes, owner: bytes
) -> bool:
    """Tell whether a grant on the chain is for these keys; a damaged one is for nobody."""
    return scan_announcement(view, spend, ephemeral, view_tag, chain_id=chain_id, robot=owner) == grantee


def derive_grant_key(
    spend: PrivateKey, view: PrivateKey, ephemeral: bytes, *, chain_id: bytes, owner: bytes
) -> PrivateKey:
    """Return the private key of G. It is derived when needed and never stored. Raises KEY_INVALID."""
    return derive_owner_key(spend, view, ephemeral, chain_id=chain_id, robot=owner)


def derive_grant_salt(view: PrivateKey, ephemeral: bytes, *, chain_id: bytes, owner: bytes) -> bytes:
    """Return the salt of the grantee's handle, as she finds it from R. Raises KEY_INVALID."""
    return _salt(view, ephemeral, chain_id, owner)


def member_hash(salt: bytes, handle: bytes) -> bytes:
    """Return what the chain holds of a grantee's handle (both 32 bytes): whoever knows the salt can check it."""
    if len(salt) != HANDLE_BYTES or len(handle) != HANDLE_BYTES:
        raise BlockRobotError("VALUE_INVALID", "A salt and a handle have 32 bytes each.")
    return tagged_hash(_MEMBER_TAG, salt, handle)


def seal_pack(pack: KeyPack, sealing_public: bytes, package_key: bytes, nonce: bytes) -> bytes:
    """Return a record's package: the pack, sealed to the grantee, under a fresh `package_key` (32) and nonce (24 bytes).

    Raises KEY_INVALID, and VALUE_INVALID for what is no pack.
    """
    if not _is_sound(pack):
        raise BlockRobotError("VALUE_INVALID", "A pack has a data key for each of its frames, in order.")
    return seal_bytes(package_key, nonce, pack.record_id, _PACKAGE_PLACE, seal_to(sealing_public, encode(pack)))


def open_pack(package: bytes, record_id: bytes, sealing_private: bytes, package_key: bytes) -> dict[int, bytes]:
    """Return the data keys by frame index. Raises ENVELOPE_INVALID if a key, the record or the bytes do not fit."""
    sealed = open_bytes(package_key, record_id, _PACKAGE_PLACE, package)
    try:
        pack = decode(open_sealed(sealing_private, sealed), KeyPack)
    except BlockRobotError:
        raise BlockRobotError("ENVELOPE_INVALID") from None
    if pack.record_id != record_id or not _is_sound(pack):
        raise BlockRobotError("ENVELOPE_INVALID", "The pack is another record's, or not whole.")
    return dict(zip(pack.indexes, pack.data_keys, strict=True))


def _is_sound(pack: KeyPack) -> bool:
    return (
        len(pack.record_id) == RECORD_ID_BYTES
        and len(pack.indexes) == len(pack.data_keys)
        and pack.indexes == sorted(set(pack.indexes))
        and all(0 <= index < CLIP_FRAMES_MAX_COUNT for index in pack.indexes)
        and all(len(key) == DATA_KEY_BYTES for key in pack.data_keys)
    )

"""Visits under one-time owner keys (ERC-5564's scheme with tagged SHA-256).

For one visit the robot draws r and makes, from the person's public view key V and spend key S: R = rG, the shared
s = H(chain, robot, rV), the owner key O = S + H(s)G and a one-byte view tag. It then forgets r and s. The person finds the
visit by vR = rV, and she alone, knowing the spend secret, can sign as O.
"""

from __future__ import annotations

from dataclasses import dataclass

from consensus.errors import BlockRobotError
from consensus.primitives.hashing import HASH_SIZE_BYTES, tagged_hash
from consensus.primitives.keys import (
    PUBLIC_KEY_SIZE_BYTES,
    PrivateKey,
    point_add,
    point_of,
    scalar_add,
    scalar_from_hash,
)

_SHARED_TAG = "blockrobot/visit"
_VIEW_TAG = "blockrobot/view-tag"
_OWNER_TAG = "blockrobot/owner"
TRANSFER_TAG = "blockrobot/transfer"


@dataclass(frozen=True, slots=True)
class VisitKeys:
    """What the chain learns of a visit: owner key O and ephemeral R (33 bytes each), and the view tag (0 to 255)."""

    owner: bytes
    ephemeral: bytes
    view_tag: int


def _shared_secret(private: PrivateKey, public: bytes, chain_id: bytes, robot: bytes) -> bytes:
    if len(chain_id) != HASH_SIZE_BYTES or len(robot) != PUBLIC_KEY_SIZE_BYTES:
        raise BlockRobotError("VALUE_INVALID", "A chain id has 32 bytes and a robot's key 33.")
    return tagged_hash(_SHARED_TAG, chain_id, robot, private.shared_point(public))


def _view_tag(shared: bytes) -> int:
    return tagged_hash(_VIEW_TAG, shared)[0]


def _tweak(shared: bytes) -> bytes:
    return scalar_from_hash(tagged_hash(_OWNER_TAG, shared))


def open_visit_keys(ephemeral_secret: bytes, view: bytes, spend: bytes, *, chain_id: bytes, robot: bytes) -> VisitKeys:
    """Return the keys of a new visit. `ephemeral_secret` is 32 fresh random bytes that the caller forgets.

    Raises KEY_INVALID if a key of the person is no point of the curve.
    """
    ephemeral = PrivateKey(ephemeral_secret)
    shared = _shared_secret(ephemeral, view, chain_id, robot)
    owner = point_add(spend, point_of(_tweak(shared)))
    return VisitKeys(owner=owner, ephemeral=ephemeral.public_key, view_tag=_view_tag(shared))


def scan_announcement(
    view: PrivateKey, spend_public: bytes, ephemeral: bytes, view_tag: int, *, chain_id: bytes, robot: bytes
) -> bytes | None:
    """Return the owner key that this announcement has if it is ours, or None if it cannot be.

    Compare the result with the announced O. The view tag is looked at first: it spares the point arithmetic for 255
    of 256 strangers' visits. An ephemeral that is no point is nobody's.
    """
    try:
        shared = _shared_secret(view, ephemeral, chain_id, robot)
    except BlockRobotError:
        return None
    if _view_tag(shared) != view_tag:
        return None
    return point_add(spend_public, point_of(_tweak(shared)))


def derive_owner_key(
    spend: PrivateKey, view: PrivateKey, ephemeral: bytes, *, chain_id: bytes, robot: bytes
) -> PrivateKey:
    """Return the private key of a visit's owner key O. It is derived when needed and never stored.

    Raises KEY_INVALID if the ephemeral is no point of the curve.
    """
    return PrivateKey(scalar_add(spend.secret, _tweak(_shared_secret(view, ephemeral, chain_id, robot))))


def sign_transfer(new_key: PrivateKey, *, chain_id: bytes, root: bytes) -> bytes:
    """Return the new owner key's 65-byte signature by which it takes over the visit with the first key `root`."""
    if len(chain_id) != HASH_SIZE_BYTES or len(root) != PUBLIC_KEY_SIZE_BYTES:
        raise BlockRobotError("VALUE_INVALID", "A chain id has 32 bytes and an owner key 33.")
    return new_key.sign(TRANSFER_TAG, chain_id + root + new_key.public_key)

"""One-time owner keys of visits (ERC-5564's scheme with tagged SHA-256).

The robot forgets r and s.
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
    """A visit's public keys: O and ephemeral R (33 bytes each), view tag (0 to 255)."""

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
    """Return a new visit's keys; `ephemeral_secret` is 32 fresh bytes to forget. Raises KEY_INVALID."""
    ephemeral = PrivateKey(ephemeral_secret)
    shared = _shared_secret(ephemeral, view, chain_id, robot)
    owner = point_add(spend, point_of(_tweak(shared)))
    return VisitKeys(owner=owner, ephemeral=ephemeral.public_key, view_tag=_view_tag(shared))


def scan_announcement(
    view: PrivateKey, spend_public: bytes, ephemeral: bytes, view_tag: int, *, chain_id: bytes, robot: bytes
) -> bytes | None:
    """Return the candidate owner key, to compare with O; None if not ours."""
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
    """Derive the private owner key O; it is never stored. Raises KEY_INVALID."""
    return PrivateKey(scalar_add(spend.secret, _tweak(_shared_secret(view, ephemeral, chain_id, robot))))


def sign_transfer(new_key: PrivateKey, *, chain_id: bytes, root: bytes) -> bytes:
    """Return the new owner key's 65-byte signature taking over visit `root`."""
    if len(chain_id) != HASH_SIZE_BYTES or len(root) != PUBLIC_KEY_SIZE_BYTES:
        raise BlockRobotError("VALUE_INVALID", "A chain id has 32 bytes and an owner key 33.")
    return new_key.sign(TRANSFER_TAG, chain_id + root + new_key.public_key)

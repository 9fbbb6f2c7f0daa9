"""The salt of a grant: the same for the two who share it, another for everything else."""

from __future__ import annotations

import pytest

from consensus.errors import BlockRobotError
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.records.sharing import derive_grant_salt

CHAIN = sha256(b"chain")
OWNER = PrivateKey(sha256(b"owner of the visit")).public_key
VIEW, EPHEMERAL = PrivateKey(sha256(b"doctor's view")), PrivateKey(sha256(b"r"))


def made(owner: bytes = OWNER, chain_id: bytes = CHAIN, ephemeral: PrivateKey = EPHEMERAL) -> bytes:
    return derive_grant_salt(ephemeral, VIEW.public_key, chain_id=chain_id, owner=owner)


def test_owner_and_grantee_derive_one_salt_and_nobody_else_nor_any_other_grant() -> None:
    assert derive_grant_salt(VIEW, EPHEMERAL.public_key, chain_id=CHAIN, owner=OWNER) == made()
    assert len(made()) == 32
    others = [made(owner=VIEW.public_key), made(chain_id=sha256(b"x")), made(ephemeral=PrivateKey(sha256(b"s")))]
    assert len({made(), *others}) == 4
    stranger = PrivateKey(sha256(b"stranger"))
    assert derive_grant_salt(stranger, EPHEMERAL.public_key, chain_id=CHAIN, owner=OWNER) != made()


def test_what_is_no_point_or_of_a_wrong_size_is_refused() -> None:
    with pytest.raises(BlockRobotError, match="KEY_INVALID"):
        derive_grant_salt(VIEW, bytes(33), chain_id=CHAIN, owner=OWNER)
    with pytest.raises(BlockRobotError, match="VALUE_INVALID"):
        derive_grant_salt(VIEW, EPHEMERAL.public_key, chain_id=CHAIN, owner=b"")

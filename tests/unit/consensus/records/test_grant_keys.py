"""What makes a grant: only its grantee finds it, derives its key and salt, and opens the pack of keys."""

from __future__ import annotations

import pytest
from nacl.public import PrivateKey as SealingKey

from consensus.errors import BlockRobotError
from consensus.primitives.hashing import sha256, tagged_hash
from consensus.primitives.keys import PrivateKey
from consensus.records.grant_keys import (
    GrantKeys,
    KeyPack,
    derive_grant_key,
    derive_grant_salt,
    is_grant_for,
    make_grant_keys,
    member_hash,
    open_pack,
    seal_pack,
)

CHAIN = sha256(b"chain")
OWNER = PrivateKey(sha256(b"owner of the visit")).public_key
SPEND, VIEW = PrivateKey(sha256(b"doctor's spend")), PrivateKey(sha256(b"doctor's view"))
HANDLE, RECORD = sha256(b"doctor"), bytes(range(16))
DOCTOR = SealingKey(sha256(b"doctor's sealing"))
PACKAGE_KEY, NONCE = sha256(b"package"), bytes(24)
PACK = KeyPack(RECORD, [0, 2], [sha256(b"0"), sha256(b"2")])


def make(owner: bytes = OWNER, secret: bytes = b"r") -> GrantKeys:
    return make_grant_keys(sha256(secret), VIEW.public_key, SPEND.public_key, chain_id=CHAIN, owner=owner)


def is_for(view: PrivateKey, spend: bytes, keys: GrantKeys, owner: bytes = OWNER) -> bool:
    return is_grant_for(
        view,
        spend,
        grantee=keys.grantee,
        ephemeral=keys.ephemeral,
        view_tag=keys.view_tag,
        chain_id=CHAIN,
        owner=owner,
    )


def test_the_grantee_finds_her_grant_signs_for_it_and_knows_its_salt() -> None:
    keys = make()
    assert is_for(VIEW, SPEND.public_key, keys)
    assert derive_grant_key(SPEND, VIEW, keys.ephemeral, chain_id=CHAIN, owner=OWNER).public_key == keys.grantee
    assert derive_grant_salt(VIEW, keys.ephemeral, chain_id=CHAIN, owner=OWNER) == keys.salt


def test_nobody_else_finds_it_and_two_grants_have_nothing_in_common() -> None:
    keys = make()
    assert not is_for(PrivateKey(sha256(b"stranger")), SPEND.public_key, keys)
    assert not is_for(VIEW, SPEND.public_key, keys, owner=PrivateKey(sha256(b"another visit")).public_key)
    others = [make(secret=b"s"), make(owner=PrivateKey(sha256(b"another visit")).public_key)]
    assert len({each.grantee for each in [keys, *others]}) == 3
    assert len({each.salt for each in [keys, *others]}) == 3


def test_a_grant_whose_ephemeral_is_no_point_is_for_nobody() -> None:
    keys = make()
    assert not is_for(VIEW, SPEND.public_key, GrantKeys(keys.grantee, bytes(33), keys.view_tag, keys.salt))


def test_the_members_hash_needs_the_salt() -> None:
    salt = make().salt
    assert member_hash(salt, HANDLE) == tagged_hash("blockrobot/grant-member", salt, HANDLE)
    assert member_hash(salt, HANDLE) != member_hash(bytes(32), HANDLE)
    with pytest.raises(BlockRobotError, match="VALUE_INVALID"):
        member_hash(salt, HANDLE[:-1])


def test_the_grantee_opens_the_keys_of_the_frames_that_are_left() -> None:
    package = seal_pack(PACK, bytes(DOCTOR.public_key), PACKAGE_KEY, NONCE)
    assert open_pack(package, RECORD, bytes(DOCTOR), PACKAGE_KEY) == {0: sha256(b"0"), 2: sha256(b"2")}


@pytest.mark.parametrize("wrong", ["package key", "sealing key", "record", "bytes"])
def test_a_package_opens_with_everything_right_or_not_at_all(wrong: str) -> None:
    package = bytearray(seal_pack(PACK, bytes(DOCTOR.public_key), PACKAGE_KEY, NONCE))
    if wrong == "bytes":
        package[-1] ^= 1
    with pytest.raises(BlockRobotError, match="ENVELOPE_INVALID"):
        open_pack(
            bytes(package),
            bytes(16) if wrong == "record" else RECORD,
            sha256(b"x") if wrong == "sealing key" else bytes(DOCTOR),
            sha256(b"x") if wrong == "package key" else PACKAGE_KEY,
        )


@pytest.mark.parametrize(
    "pack",
    [
        KeyPack(RECORD, [2, 0], PACK.data_keys),
        KeyPack(RECORD, [0, 0], PACK.data_keys),
        KeyPack(RECORD, [0], PACK.data_keys),
        KeyPack(RECORD, [0, 64], PACK.data_keys),
        KeyPack(RECORD, [0], [b"short"]),
        KeyPack(b"short", [0, 2], PACK.data_keys),
    ],
)
def test_what_is_no_pack_is_not_sealed(pack: KeyPack) -> None:
    with pytest.raises(BlockRobotError, match="VALUE_INVALID"):
        seal_pack(pack, bytes(DOCTOR.public_key), PACKAGE_KEY, NONCE)

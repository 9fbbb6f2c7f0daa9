"""Sharing for any keys: any two custodians' parts join to the key, one's never, and the package opens for one grantee."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from nacl.public import PrivateKey as SealingKey

from consensus.errors import BlockRobotError
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey
from consensus.records.envelopes import seal_bytes, seal_to
from consensus.records.sharing import (
    KeyPart,
    count_masks,
    derive_grantee_key,
    hash_grant_member,
    join_parts,
    open_grant_keys,
    open_package,
    scan_grant,
    seal_package,
    split_share_key,
)

T = sha256(b"the key of one record's package")
RECORD = b"r" * 16
keys = st.binary(min_size=1, max_size=40).map(lambda seed: PrivateKey(sha256(seed)))


def custodian(number: int) -> bytes:
    return PrivateKey(sha256(b"custodian %d" % number)).public_key


def masks(count: int, seed: bytes) -> list[bytes]:
    return [sha256(seed + bytes((number,))) for number in range(count_masks(count))]


@given(secret=st.binary(min_size=32, max_size=32), count=st.integers(2, 7), seed=st.binary(max_size=8))
def test_any_two_custodians_join_to_the_key_and_one_alone_to_nothing(secret: bytes, count: int, seed: bytes) -> None:
    parts = split_share_key(secret, [custodian(number) for number in range(count)], masks(count, seed))
    assert len(parts) == count
    for holder, own in parts.items():
        assert len(own) == count - 1
        assert join_parts({holder: own}) == []
    for first, second in combinations(parts, 2):
        assert join_parts({first: parts[first], second: parts[second]}) == [secret]
    assert join_parts(parts) == [secret]


@given(
    secret=st.binary(min_size=32, max_size=32), other=st.binary(min_size=32, max_size=32), seed=st.binary(max_size=8)
)
def test_what_one_custodian_holds_fits_every_key(secret: bytes, other: bytes, seed: bytes) -> None:
    """For each other key there are masks by which this custodian would hold just the same: its parts say nothing."""
    known = sorted(custodian(number) for number in range(3))
    drawn = masks(3, seed)
    held = split_share_key(secret, known, drawn)
    difference = bytes(a ^ b for a, b in zip(secret, other, strict=True))
    for place, holder in enumerate(known):
        pairs = list(combinations(range(3), 2))
        fitting = [
            bytes(a ^ b for a, b in zip(mask, difference, strict=True)) if pair[1] == place else mask
            for pair, mask in zip(pairs, drawn, strict=True)
        ]
        assert split_share_key(other, known, fitting)[holder] == held[holder]


def test_a_lying_custodian_spoils_only_its_own_pairs() -> None:
    known = sorted(custodian(number) for number in range(3))
    parts = split_share_key(T, known, masks(3, b"liar"))
    parts[known[1]] = [KeyPart(part.custodian, bytes(32)) for part in parts[known[1]]]
    joined = join_parts(parts)
    assert T in joined
    assert len(joined) == 3
    sealing = SealingKey(sha256(b"x"))
    package = seal_package(
        T, bytes(24), bytes(sealing.public_key), grantee=custodian(9), record_id=RECORD, keys={0: bytes(32)}
    )
    assert open_package(joined, bytes(sealing), package, grantee=custodian(9), record_id=RECORD) == {0: bytes(32)}


def test_a_single_custodian_holds_the_key_itself() -> None:
    only = custodian(0)
    parts = split_share_key(T, [only], [])
    assert parts == {only: [KeyPart(only, T)]}
    assert join_parts(parts) == [T]


@pytest.mark.parametrize(
    ("key", "custodians", "count"),
    [
        (T[:31], [custodian(0), custodian(1)], 1),
        (T, [custodian(0), custodian(1)], 0),
        (T, [custodian(0), custodian(0)], 1),
        (T, [custodian(0), b"short"], 1),
        (T, [], 0),
    ],
)
def test_nothing_is_split_but_by_the_rules(key: bytes, custodians: list[bytes], count: int) -> None:
    with pytest.raises(BlockRobotError, match=r"^VALUE_INVALID:"):
        split_share_key(key, custodians, [bytes(32)] * count)


@given(spend=keys, view=keys, other=keys, owner=keys, secret=st.binary(max_size=20))
def test_the_grantee_finds_her_grant_and_nobody_else_does(
    spend: PrivateKey, view: PrivateKey, other: PrivateKey, owner: PrivateKey, secret: bytes
) -> None:
    where = {"chain_id": sha256(b"chain"), "owner": owner.public_key}
    made = open_grant_keys(sha256(b"e" + secret), view.public_key, spend.public_key, **where)
    assert scan_grant(view, spend.public_key, made.ephemeral, made.view_tag, **where) == made.owner
    assert derive_grantee_key(spend, view, made.ephemeral, **where).public_key == made.owner
    if other.public_key not in (view.public_key, owner.public_key):
        assert scan_grant(other, spend.public_key, made.ephemeral, made.view_tag, **where) != made.owner
        elsewhere = where | {"owner": other.public_key}
        assert scan_grant(view, spend.public_key, made.ephemeral, made.view_tag, **elsewhere) != made.owner


@given(data_keys=st.dictionaries(st.integers(0, 63), st.binary(min_size=32, max_size=32), min_size=1, max_size=64))
def test_a_package_opens_for_its_grantee_and_record_alone(data_keys: dict[int, bytes]) -> None:
    sealing, grantee = SealingKey(sha256(b"x")), custodian(5)
    public = bytes(sealing.public_key)
    package = seal_package(T, bytes(24), public, grantee=grantee, record_id=RECORD, keys=data_keys)
    assert open_package([bytes(32), T], bytes(sealing), package, grantee=grantee, record_id=RECORD) == data_keys
    cases: tuple[dict[str, Any], ...] = (
        {"candidates": [bytes(32)]},
        {"sealing_private": bytes(SealingKey(sha256(b"y")))},
        {"grantee": custodian(6)},
        {"record_id": b"s" * 16},
        {"package": package[:-1] + bytes((package[-1] ^ 1,))},
    )
    for wrong in cases:
        right: dict[str, Any] = {"candidates": [T], "sealing_private": bytes(sealing), "package": package}
        with pytest.raises(BlockRobotError, match=r"^ENVELOPE_INVALID:"):
            open_package(**{**right, "grantee": grantee, "record_id": RECORD, **wrong})


def test_without_two_custodians_the_package_stays_closed_and_says_so() -> None:
    with pytest.raises(BlockRobotError, match=r"^GRANT_PARTS_MISSING:"):
        open_package([], bytes(32), b"", grantee=custodian(0), record_id=RECORD)


def test_a_package_that_somebody_else_filled_opens_nothing_and_a_grantee_is_hidden_by_a_salt() -> None:
    sealing = SealingKey(sha256(b"x"))
    forged = seal_bytes(T, bytes(24), RECORD, 0, seal_to(bytes(sealing.public_key), b"\xc0" * 40))
    with pytest.raises(BlockRobotError, match=r"^ENVELOPE_INVALID:"):
        open_package([T], bytes(sealing), forged, grantee=custodian(0), record_id=RECORD)
    handle = sha256(b"handle")
    assert hash_grant_member(bytes(32), handle) != hash_grant_member(sha256(b"salt"), handle)
    with pytest.raises(BlockRobotError, match=r"^VALUE_INVALID:"):
        hash_grant_member(b"", handle)

"""Owner keys: found and used by their person, meaningless to everyone else."""

from __future__ import annotations

import pytest

from consensus.errors import BlockRobotError
from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey, recover
from consensus.records.owner_keys import (
    TRANSFER_TAG,
    VisitKeys,
    derive_owner_key,
    open_visit_keys,
    scan_announcement,
    sign_transfer,
)

CHAIN = sha256(b"chain")
ROBOT = PrivateKey(sha256(b"robot")).public_key
SPEND, VIEW = PrivateKey(sha256(b"spend")), PrivateKey(sha256(b"view"))


def _open(secret: bytes = b"r", robot: bytes = ROBOT, chain_id: bytes = CHAIN) -> VisitKeys:
    return open_visit_keys(sha256(secret), VIEW.public_key, SPEND.public_key, chain_id=chain_id, robot=robot)


def test_the_scheme_stays_as_published_and_the_view_key_does_not_sign() -> None:
    visit = _open()
    assert visit.owner.hex() == "03cc2e451f107adf91c7b76ab6cd2d73596644674ef89eddbc2ee3e4f1f33f22ab"
    assert visit.ephemeral == PrivateKey(sha256(b"r")).public_key
    assert visit.view_tag == 253
    other_spend = PrivateKey(sha256(b"other"))
    derived = derive_owner_key(other_spend, VIEW, visit.ephemeral, chain_id=CHAIN, robot=ROBOT)
    assert derived.public_key != visit.owner


def test_another_robot_chain_or_secret_makes_another_owner() -> None:
    owners = {
        _open().owner,
        _open(b"s").owner,
        _open(robot=SPEND.public_key).owner,
        _open(chain_id=sha256(b"other")).owner,
    }
    assert len(owners) == 4


def test_a_stranger_finds_nothing_even_where_the_view_tag_agrees() -> None:
    strangers = 0
    for number in range(600):
        visit = _open(number.to_bytes(2, "big"))
        stranger = PrivateKey(sha256(b"stranger"))
        found = scan_announcement(
            stranger, SPEND.public_key, visit.ephemeral, visit.view_tag, chain_id=CHAIN, robot=ROBOT
        )
        strangers += found is not None
        assert found != visit.owner
    assert strangers < 15


def test_what_is_no_point_is_nobodys_and_opens_no_visit() -> None:
    for ephemeral in (b"", bytes(33), b"\x02" + b"\xff" * 32):
        assert scan_announcement(VIEW, SPEND.public_key, ephemeral, 0, chain_id=CHAIN, robot=ROBOT) is None
        with pytest.raises(BlockRobotError, match="KEY_INVALID"):
            derive_owner_key(SPEND, VIEW, ephemeral, chain_id=CHAIN, robot=ROBOT)
    with pytest.raises(BlockRobotError, match="KEY_INVALID"):
        open_visit_keys(sha256(b"r"), bytes(33), SPEND.public_key, chain_id=CHAIN, robot=ROBOT)
    with pytest.raises(BlockRobotError, match="VALUE_INVALID"):
        open_visit_keys(sha256(b"r"), VIEW.public_key, SPEND.public_key, chain_id=b"", robot=ROBOT)


def test_the_new_key_signs_the_chain_the_visit_and_itself() -> None:
    new, chain_id, root = PrivateKey(sha256(b"new")), sha256(b"chain"), PrivateKey(sha256(b"root")).public_key
    signature = sign_transfer(new, chain_id=chain_id, root=root)
    assert recover(TRANSFER_TAG, signature, chain_id + root + new.public_key) == new.public_key
    for wrong in ({"chain_id": b"short", "root": root}, {"chain_id": chain_id, "root": b"short"}):
        with pytest.raises(BlockRobotError, match=r"^VALUE_INVALID:"):
            sign_transfer(new, **wrong)

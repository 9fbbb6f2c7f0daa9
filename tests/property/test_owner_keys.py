"""Owner keys for any keys and secrets: what the robot makes, the person finds and can use."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from consensus.primitives.hashing import sha256
from consensus.primitives.keys import PrivateKey, verify
from consensus.records.owner_keys import derive_owner_key, open_visit_keys, scan_announcement

keys = st.binary(min_size=1, max_size=40).map(lambda seed: PrivateKey(sha256(seed)))


@given(spend=keys, view=keys, robot=keys, secret=st.binary(max_size=40), chain=st.binary(max_size=8))
def test_robot_and_person_agree(
    spend: PrivateKey, view: PrivateKey, robot: PrivateKey, secret: bytes, chain: bytes
) -> None:
    where = {"chain_id": sha256(chain), "robot": robot.public_key}
    visit = open_visit_keys(sha256(b"r" + secret), view.public_key, spend.public_key, **where)
    found = scan_announcement(view, spend.public_key, visit.ephemeral, visit.view_tag, **where)
    assert found == visit.owner
    private = derive_owner_key(spend, view, visit.ephemeral, **where)
    assert private.public_key == visit.owner
    assert verify(visit.owner, "blockrobot/test", private.sign_compact("blockrobot/test", b"x"), b"x")
    assert visit.owner not in (spend.public_key, view.public_key, visit.ephemeral)


@given(spend=keys, view=keys, other=keys, robot=keys, secret=st.binary(max_size=40))
def test_a_wrong_view_tag_or_view_key_finds_nothing(
    spend: PrivateKey, view: PrivateKey, other: PrivateKey, robot: PrivateKey, secret: bytes
) -> None:
    where = {"chain_id": sha256(b"chain"), "robot": robot.public_key}
    visit = open_visit_keys(sha256(b"r" + secret), view.public_key, spend.public_key, **where)
    wrong_tag = (visit.view_tag + 1) % 256
    assert scan_announcement(view, spend.public_key, visit.ephemeral, wrong_tag, **where) is None
    if other.public_key != view.public_key:
        assert scan_announcement(other, spend.public_key, visit.ephemeral, visit.view_tag, **where) != visit.owner

"""Showing a stranger one sealed note: the key of one box opens that box, for its owner's public key, and no other."""

from __future__ import annotations

import pytest
from nacl.public import PrivateKey

from consensus.errors import BlockRobotError
from consensus.records.envelopes import derive_box_key, open_disclosed_metadata, open_metadata, seal_metadata

OWNER, STRANGER = PrivateKey(bytes([7] * 32)), PrivateKey(bytes([8] * 32))
NOTE = b"depth, five past nine, four frames"


def sealed(content: bytes = NOTE) -> bytes:
    return seal_metadata(bytes(OWNER.public_key), content)


def test_the_key_of_a_box_opens_it_and_no_other_and_is_not_the_private_key() -> None:
    box = sealed()
    key = derive_box_key(bytes(OWNER), box)
    assert open_disclosed_metadata(bytes(OWNER.public_key), key, box) == NOTE == open_metadata(bytes(OWNER), box)
    key = derive_box_key(bytes(OWNER), sealed())
    with pytest.raises(BlockRobotError, match="ENVELOPE_INVALID"):
        open_disclosed_metadata(bytes(OWNER.public_key), key, sealed())
    keys = {derive_box_key(bytes(OWNER), sealed()) for _ in range(20)}
    assert len(keys) == 20
    assert bytes(OWNER) not in keys


def test_a_box_is_its_owners_and_nobody_elses_and_no_changed_byte_opens() -> None:
    box = sealed()
    for owner, public in ((STRANGER, STRANGER), (STRANGER, OWNER), (OWNER, STRANGER)):
        with pytest.raises(BlockRobotError, match="ENVELOPE_INVALID"):
            open_disclosed_metadata(bytes(public.public_key), derive_box_key(bytes(owner), box), box)
    key = derive_box_key(bytes(OWNER), box)
    for place in range(0, len(box), 7):
        changed = box[:place] + bytes([box[place] ^ 1]) + box[place + 1 :]
        with pytest.raises(BlockRobotError, match="ENVELOPE_INVALID"):
            open_disclosed_metadata(bytes(OWNER.public_key), key, changed)


@pytest.mark.parametrize("wrong", [b"", bytes(31), bytes(33)])
def test_wrong_sizes_and_points_of_low_order_are_refused(wrong: bytes) -> None:
    box = sealed()
    key = derive_box_key(bytes(OWNER), box)
    for arguments in ((wrong, key, box), (bytes(OWNER.public_key), wrong, box), (bytes(OWNER.public_key), key, wrong)):
        with pytest.raises(BlockRobotError, match="ENVELOPE_INVALID"):
            open_disclosed_metadata(*arguments)
    with pytest.raises(BlockRobotError, match="ENVELOPE_INVALID"):
        derive_box_key(wrong, box)
    with pytest.raises(BlockRobotError, match="ENVELOPE_INVALID"):
        derive_box_key(bytes(OWNER), wrong[:31])
    with pytest.raises(BlockRobotError, match="ENVELOPE_INVALID"):
        derive_box_key(bytes(OWNER), bytes(len(box)))

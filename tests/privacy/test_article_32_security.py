"""GDPR Article 32: security that fits the risk, as far as a program can show it.

(1)(a) what leaves the robot is encrypted for one person, and stored under keys that stand elsewhere; (b) and (d) what one
custodian lost is found and another has it: `offchain/test_scrub.py`; (c) after a crash everything is there; (4) nobody
who has no business with it comes in.
"""

from __future__ import annotations

import pytest

from consensus.errors import BlockRobotError
from consensus.records.envelopes import open_data_key
from node.api.openapi.authorisation_page import CALLERS, refusal_of
from node.api.routes import ROUTES
from tests.offchain.conftest import house, make_store  # noqa: F401 - fixtures
from tests.offchain.house import ACCESS_ID, CustodianHarness, read_all
from tests.offchain.small_chain import ALICE, access, record_clip

on_disk = pytest.mark.parametrize("make_store", ["sqlite"], indirect=True)


@on_disk
async def test_1_a_it_is_encrypted_for_one_person_under_keys_that_stand_elsewhere(house: CustodianHarness) -> None:  # noqa: F811
    clip, other = record_clip(), record_clip()
    async with house.open() as custodian:
        await house.keep(clip)
        (row, *_) = await house.store.frames(clip.record_id)
        assert clip.upload.sealed_keys[0] not in row.wrapped_key, "the store alone has not even what only she opens"
        assert house.keys.read(row.slot) not in row.wrapped_key + row.ciphertext
        await house.follow(access(ACCESS_ID, clip))
        download = await custodian.download(clip.record_id, ACCESS_ID, ALICE)
        assert read_all(clip, download) == list(clip.plaintexts)
        frame = download.frames[0]
        with pytest.raises(BlockRobotError, match=r"^ENVELOPE_INVALID:"):
            open_data_key(bytes(other.sealing), frame.sealed_key)


@on_disk
async def test_1_c_after_a_crash_everything_is_there(house: CustodianHarness) -> None:  # noqa: F811
    clip = record_clip()
    async with house.open():
        await house.keep(clip)
    async with house.open() as custodian:
        await house.follow(access(ACCESS_ID, clip))
        assert read_all(clip, await custodian.download(clip.record_id, ACCESS_ID, ALICE)) == list(clip.plaintexts)


def test_4_clips_are_for_those_who_have_business_with_them() -> None:
    admitted = {
        route.operation: {caller.name for caller in CALLERS if not refusal_of(route.access, caller)} for route in ROUTES
    }
    assert admitted["uploadClip"] == {"robot"}
    assert admitted["downloadClip"] == {"owner key"}

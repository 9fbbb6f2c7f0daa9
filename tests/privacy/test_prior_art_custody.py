"""Defects of the published prototype that concern custody, each as a test that this system does not have it.

6: the chain deletes `>= minTime`, the store `> minTime`, so that the first frame of an erased range stays for ever.
7: the hook acts on blocks that can still be undone, keeps its position in memory, and starts again from block 0.
1: pictures are stored in plaintext. 9: frames are handed out before anything is signed for.
"""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from consensus.errors import BlockRobotError
from node.offchain.custodian import Custodian
from node.offchain.erase_keys import EraseKeys
from node.offchain.sqlite_store import SqliteStore
from tests.offchain.small_chain import ALICE, CUSTODIAN, EXPIRES_MS, SmallChain, access, erasure, record_clip, recorded


@asynccontextmanager
async def custodian_in(directory: Path, chain: SmallChain) -> AsyncIterator[Custodian]:
    async with SqliteStore(directory / "custody") as store:
        with EraseKeys(directory / "erase-keys") as keys:
            custodian = Custodian(store, keys, member=CUSTODIAN, clock_ms=lambda: chain.time_ms)
            await custodian.start()
            yield custodian


def all_bytes_in(folder: Path) -> bytes:
    return b"".join(path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file())


@pytest.mark.parametrize("frames", [(0,), (5,), (0, 1, 2), (3, 4, 5), (0, 1, 2, 3, 4, 5)])
async def test_6_an_erased_range_loses_its_first_and_its_last_frame(tmp_path: Path, frames: tuple[int, ...]) -> None:
    chain, clip = SmallChain(), record_clip(6)
    async with custodian_in(tmp_path, chain) as custodian:
        await custodian.stage(clip.upload)
        await custodian.on_finalized_block(chain.block(recorded(clip), erasure(b"\x01" * 32, clip, frames=frames)))
        held = (await custodian.export(clip.record_id)).frames
        assert [frame.index for frame in held if frame.erased] == list(frames)


async def test_6_a_record_expires_at_its_very_millisecond(tmp_path: Path) -> None:
    chain, clip = SmallChain(), record_clip()
    async with custodian_in(tmp_path, chain) as custodian:
        await custodian.stage(clip.upload)
        await custodian.on_finalized_block(chain.block(recorded(clip)))
        await custodian.on_finalized_block(chain.block(at_ms=EXPIRES_MS - 1))
        assert not (await custodian.export(clip.record_id)).frames[0].erased
        await custodian.on_finalized_block(chain.block(at_ms=EXPIRES_MS))
        with pytest.raises(BlockRobotError) as refusal:
            await custodian.export(clip.record_id)
        assert refusal.value.code == "CLIP_ERASED"


async def test_7_the_position_survives_a_restart_and_old_blocks_change_nothing(tmp_path: Path) -> None:
    chain, clip = SmallChain(), record_clip()
    async with custodian_in(tmp_path, chain) as custodian:
        await custodian.stage(clip.upload)
        await custodian.on_finalized_block(chain.block(recorded(clip)))
        await custodian.on_finalized_block(chain.block(erasure(b"\x01" * 32, clip)))
        owed = await custodian.owed(10)
    async with custodian_in(tmp_path, chain) as custodian:
        assert (await custodian.checkpoint()).height == 2
        for block in chain.blocks:
            await custodian.on_finalized_block(block)
        assert await custodian.owed(10) == owed
        assert await custodian.missing(10) == []


async def test_7_a_block_of_a_fork_is_refused_whole(tmp_path: Path) -> None:
    chain, clip = SmallChain(), record_clip()
    async with custodian_in(tmp_path, chain) as custodian:
        await custodian.stage(clip.upload)
        await custodian.on_finalized_block(chain.block(recorded(clip)))
        await custodian.on_finalized_block(chain.block())
        forked = replace(chain.block(erasure(b"\x01" * 32, clip)), height=2, block_id=b"\xff" * 32)
        with pytest.raises(BlockRobotError) as refusal:
            await custodian.on_finalized_block(forked)
        assert refusal.value.code == "CUSTODY_OUT_OF_ORDER"
        assert not any(frame.erased for frame in (await custodian.export(clip.record_id)).frames)
        assert await custodian.owed(10) == []


async def test_1_no_picture_and_no_key_that_opens_one_is_in_a_custodians_files(tmp_path: Path) -> None:
    chain, clip = SmallChain(), record_clip()
    async with custodian_in(tmp_path, chain) as custodian:
        await custodian.stage(clip.upload)
        await custodian.on_finalized_block(chain.block(recorded(clip)))
        written = all_bytes_in(tmp_path)
        assert clip.upload.ciphertexts[0][:64] in written
        for secret in (*clip.plaintexts, *clip.data_keys, *clip.upload.sealed_keys):
            assert secret not in written


async def test_9_no_frame_is_handed_out_before_its_owner_signed_for_it_on_chain(tmp_path: Path) -> None:
    chain, clip, access_id = SmallChain(), record_clip(), b"\x0a" * 32
    async with custodian_in(tmp_path, chain) as custodian:
        await custodian.stage(clip.upload)
        await custodian.on_finalized_block(chain.block(recorded(clip)))
        request = chain.block(access(access_id, clip))
        with pytest.raises(BlockRobotError) as refusal:
            await custodian.download(clip.record_id, access_id, ALICE)
        assert refusal.value.code == "ACCESS_NOT_GRANTED"
        await custodian.on_finalized_block(request)
        assert len((await custodian.download(clip.record_id, access_id, ALICE)).frames) == 3

"""A custodian that is behind follows blocks together: with the same end as one by one, by as few commands as one."""

from __future__ import annotations

import random
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from node.custody.finalized_events import FinalizedEvents
from node.custody.stores.mongo_store import MongoStore
from node.custody.stores.sqlite_store import SqliteStore
from tests.offchain.house import CustodianHarness
from tests.offchain.recorded_commands import recorded_commands
from tests.offchain.small_chain import START_MS, RecordedClip, access, erasure, record_clip, recorded

BLOCKS_COUNT = 24
COMMANDS_MAX_COUNT = 17
"""Two reads of what is recorded, six of what is due, and a transaction of nine."""


def _events(dice: random.Random, clips: list[RecordedClip], number: int, fresh: list[RecordedClip]) -> list[Any]:
    """Mostly of what is only recorded; some of it expires before the last block."""
    events: list[Any] = []
    for _ in range(dice.randrange(3)):
        clips.append(fresh.pop())
        events.append(recorded(clips[-1], expires_at_ms=START_MS + 1000 * dice.choice([number + 2, 10_000])))
    if clips and dice.random() < 0.15:
        events.append(access(dice.randbytes(32), dice.choice(clips)))
    if clips and dice.random() < 0.1:
        events.append(erasure(dice.randbytes(32), dice.choice(clips), frames=dice.choice([(), (0,)])))
    return events


async def _state(house: CustodianHarness) -> list[Any]:
    store = house.store
    clips = [clip async for clip in store.all_clips()]
    grants = [grant async for grant in store.all_grants()]
    frames = await store.frame_places([clip.record_id for clip in clips])
    kept = [(place.record_id, place.index) for place in frames]
    return [clips, kept, await store.absent(b"", 1000), grants, await house.ready_outbox(), await store.checkpoint()]


async def _follow(
    folder: Path, staged: Sequence[RecordedClip], batches: Sequence[Sequence[FinalizedEvents]]
) -> list[Any]:
    house = CustodianHarness(lambda: SqliteStore(folder / "custody"), folder / "erase-keys")
    async with house.open() as custodian:
        for clip in staged:
            await custodian.stage(clip.upload)
        for batch in batches:
            await custodian.on_finalized_blocks(batch)
        return await _state(house)


@pytest.mark.parametrize("seed", range(12))
async def test_blocks_that_are_followed_together_end_as_one_by_one(tmp_path: Path, seed: int) -> None:
    dice, chain, clips = random.Random(seed), CustodianHarness(lambda: None, tmp_path).chain, list[RecordedClip]()
    fresh = [record_clip(2, valid_until_ms=START_MS + 1000 * dice.randrange(1, 60)) for _ in range(3 * BLOCKS_COUNT)]
    staged = dice.sample(fresh, len(fresh) // 2)
    blocks = [chain.block(*_events(dice, clips, number, fresh)) for number in range(BLOCKS_COUNT)]
    single = await _follow(tmp_path / "single", staged, [[block] for block in blocks])
    for size in (5, BLOCKS_COUNT):
        batches = [blocks[first : first + size] for first in range(0, BLOCKS_COUNT, size)]
        assert await _follow(tmp_path / str(size), staged, batches) == single


async def test_a_clip_that_lapses_by_the_block_that_records_it_is_kept(tmp_path: Path) -> None:
    house = CustodianHarness(lambda: SqliteStore(tmp_path / "custody"), tmp_path / "erase-keys")
    clip = record_clip(valid_until_ms=START_MS + 1000)
    async with house.open() as custodian:
        await custodian.stage(clip.upload)
        await custodian.on_finalized_blocks([house.chain.block(recorded(clip)), house.chain.block()])
        assert (await house.store.clips([clip.record_id]))[clip.record_id].status == "confirmed"


async def test_many_blocks_that_only_record_cost_the_commands_of_one(tmp_path: Path, mongo_database: str) -> None:
    house, costs = CustodianHarness(lambda: MongoStore(mongo_database), tmp_path / "erase-keys"), []
    with recorded_commands() as commands:
        async with house.open() as custodian:
            await house.follow()
            for count in (1, 8):
                clips = [[record_clip() for _ in range(4)] for _ in range(count)]
                for clip in (clip for each in clips for clip in each[:2]):
                    await custodian.stage(clip.upload)
                blocks = [house.chain.block(*map(recorded, each)) for each in clips]
                commands.sent.clear()
                await custodian.on_finalized_blocks(blocks)
                costs.append([f"{command.kind} {command.collection}".strip() for command in commands.sent])
    one, eight = costs
    assert len(eight) == len(one) <= COMMANDS_MAX_COUNT

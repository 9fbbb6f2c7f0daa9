"""Custodians join, leave and die under load, with erasures under way: nothing is lost, and nothing erased is kept."""

from __future__ import annotations

import random

import pytest

from consensus.errors import BlockRobotError
from consensus.primitives.hashing import sha256
from consensus.records.clips import ClipDownload
from consensus.records.placement import Placement
from network.sim.world.custody_store import MemoryEraseKeys, SimCustodyStore
from node.custody.coordination.custody_coordinator import CLIP_ABSENT_CODES
from node.custody.custodian import Custodian
from tests.offchain.small_chain import RecordedClip, SmallChain, erasure, record_clip, recorded

STEPS_COUNT, RECORDS_MAX_COUNT = 400, 60
MEMBERS_MIN_COUNT, MEMBERS_MAX_COUNT = 3, 7
LIFETIME_MS = 60_000


async def no_pause() -> None: ...


class Member:
    """A custodian in memory, which follows the blocks when it is told to, and serves others."""

    def __init__(self, town: Town, number: int) -> None:
        self.name = f"custodian {number}"
        self.member = b"\x02" + sha256(self.name.encode())
        self.store = SimCustodyStore(no_pause)
        self.followed = 0
        self.custodian = Custodian(
            self.store,
            MemoryEraseKeys(random.Random(number)),
            member=self.member,
            clock_ms=lambda: town.chain.time_ms,
            find_placement=lambda: town.placement,
        )

    async def fetch(self, record_id: bytes) -> ClipDownload | None:
        try:
            return await self.custodian.export(record_id)
        except BlockRobotError as error:
            if error.code not in CLIP_ABSENT_CODES:
                raise
            return None

    async def holds(self, record_id: bytes) -> bool:
        clip = (await self.store.clips([record_id])).get(record_id)
        return clip is not None and clip.status == "confirmed"


class Town:
    """A chain, its custodians, and robots and owners that go on whoever comes and goes."""

    def __init__(self, seed: int) -> None:
        self.dice = random.Random(seed)
        self.chain = SmallChain()
        self.copies = 2
        self.members: list[Member] = []
        self.known: dict[bytes, RecordedClip] = {}
        self.brought: list[RecordedClip] = []
        self.erased: dict[bytes, set[int]] = {}
        self.came = 0
        self.left = 0

    @property
    def placement(self) -> Placement:
        return Placement.even([each.member for each in self.members], self.copies)

    # What happens

    async def bring(self) -> None:
        """Upload a clip; now and then a keeper does not take it, and the next in the ranking does."""
        clip = record_clip(2, valid_until_ms=self.chain.time_ms + LIFETIME_MS)
        by_key = {each.member: each for each in self.members}
        ranked = [by_key[key] for key in self.placement.rank(clip.record_id)]
        if self.dice.random() < 0.2:
            ranked.pop(0)
        for each in ranked[:2]:
            await each.custodian.stage(clip.upload)
        self.brought.append(clip)

    async def record(self) -> None:
        if self.brought:
            clip = self.brought.pop(0)
            self.known[clip.record_id] = clip
            self.chain.block(recorded(clip))

    async def erase(self) -> None:
        left = [record_id for record_id in self.known if record_id not in self.erased]
        if left:
            record_id = self.dice.choice(left)
            frames = self.dice.choice([(), (1,)])
            self.erased[record_id] = set(frames) or {0, 1}
            erasure_id = sha256(b"erasure" + record_id)
            self.chain.block(erasure(erasure_id, self.known[record_id], frames=frames))

    async def follow(self) -> None:
        await self._follow(self.dice.choice(self.members))

    async def _follow(self, member: Member) -> None:
        for block in self.chain.blocks[member.followed : member.followed + 3]:
            await member.custodian.on_finalized_block(block)
            member.followed = block.height

    async def fetch(self) -> None:
        await self._fetch(self.dice.choice(self.members))

    async def _fetch(self, member: Member) -> None:
        await member.custodian.follow_placement()
        await member.custodian.fetch_missing([each for each in self.members if each is not member])

    async def join(self) -> None:
        if len(self.members) < MEMBERS_MAX_COUNT:
            self.came += 1
            member = Member(self, self.came)
            await member.custodian.start()
            self.members.append(member)

    async def go(self) -> None:
        """One leaves or dies, as operators may: once nothing is missing anywhere."""
        if len(self.members) > MEMBERS_MIN_COUNT and self.dice.random() < 0.5:
            await self.settle()
            self.left += 1
            self.members.remove(self.dice.choice(self.members))

    async def decide(self) -> None:
        self.copies = self.dice.choice([0, 2, 2, 3])

    async def settle(self) -> None:
        while self.brought:
            await self.record()
        for member in self.members:
            while member.followed < len(self.chain.blocks):
                await self._follow(member)
        for _ in range(20):
            for member in self.members:
                await self._fetch(member)
            if not any([(await member.store.counts()).missing for member in self.members]):
                return
        raise AssertionError("a clip is missing that nobody has")

    async def run(self) -> None:
        for _ in range(4):
            await self.join()
        work = [self.bring] * 6 + [self.record] * 6 + [self.follow] * 12 + [self.fetch] * 4 + [self.erase] * 2
        work += [self.join, self.go, self.decide]
        for _ in range(STEPS_COUNT):
            await self.dice.choice(work)()
        await self.settle()


@pytest.mark.parametrize("seed", range(6))
async def test_what_is_not_erased_is_at_all_its_keepers_and_what_is_erased_at_nobody(seed: int) -> None:
    town = Town(seed)
    await town.run()
    assert min(town.left, len(town.erased), len(town.known) // 9) >= 1, "it has tried something"
    for record_id in town.known:
        gone = town.erased.get(record_id, set())
        for member in town.members:
            holds = await member.holds(record_id)
            if gone == {0, 1}:
                assert not holds
                assert await member.store.frame_places([record_id]) == []
                continue
            assert holds or not town.placement.is_keeper(member.member, record_id)
            if holds:
                found = await member.custodian.look_at(record_id)
                assert [frame.index for frame in found.frames if frame.erased] == sorted(gone)
    for member in town.members:
        owed = {row.subject for row in await member.custodian.ready_outbox(1_000) if row.kind == "erasure.receipt"}
        assert owed == {sha256(b"erasure" + record_id) for record_id in town.erased}, "each confirms each erasure"

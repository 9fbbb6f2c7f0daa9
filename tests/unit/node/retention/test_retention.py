"""Which blocks are old enough to go: by block time, with records that live and claims that keep them."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, replace
from importlib.resources import files

import pytest
from hypothesis import given
from hypothesis import strategies as st

from consensus.chain.block import ContractEvent
from consensus.errors import BlockRobotError
from consensus.limits import RETENTION_MAX_MS, TRANSACTION_LIFETIME_MAX_MS
from consensus.primitives.encoding import encode, encode_value
from consensus.state.records import RECORD, RecordRow
from consensus.state.rights import RESTRICTION, RestrictionRow
from node.retention.retention import (
    BLOCKS_KEPT_MS,
    LIVE_RECORD_HELD_MAX_MS,
    Cutoff,
    HeldBy,
    Retention,
    find_first_since,
)
from node.storage.memory_store import MemoryStore
from tests.state_rows import stored
from tests.unit.node.written_chain import WrittenChain

DAY_MS = 24 * 3600 * 1000
OWNER = b"\x02" * 33


@dataclass(frozen=True)
class Recorded:
    """A record in a block: how long it is kept, its status now, and until when (after recording) a claim keeps it."""

    retention_ms: int
    status: str = "active"
    claimed_ms: int = 0


class RecordingChain(WrittenChain):
    """A chain without transactions, whose blocks tell of records and write them."""

    def block(self, later_ms: int, *records: Recorded) -> None:
        time_ms = self.blocks[-1].header.timestamp_ms + later_ms
        writes: dict[bytes, bytes | None] = {}
        events = []
        for number, each in enumerate(records):
            record_id = len(self.blocks).to_bytes(8) + number.to_bytes(8)
            owner = OWNER + record_id
            expires_at_ms = time_ms + each.retention_ms
            fields = {"owner": owner, "status": each.status, "expires_at_ms": expires_at_ms}
            writes[RECORD.key(record_id)] = stored(RecordRow, **fields)
            if each.claimed_ms:
                until_ms = time_ms + each.claimed_ms
                writes[RESTRICTION.key(owner)] = stored(RestrictionRow, until_ms=until_ms, records=[record_id])
            told = encode_value({"record_id": record_id, "owner": owner, "expires_at_ms": expires_at_ms})
            events.append(encode(ContractEvent("records", "recorded", told)))
        block = self.extend(writes, transactions=0, later_ms=later_ms)
        self.stored[-1] = replace(block, events=events)

    async def store(self) -> MemoryStore:
        made = MemoryStore()
        await self.fill(made)
        return made


async def cutoff_of(chain: RecordingChain, keep: int = 1, followed: int | None = None) -> Cutoff:
    return await Retention(await chain.store()).find_cutoff(keep, followed)


async def test_the_longest_retention_is_that_of_the_contract_and_without_a_block_there_is_no_cutoff() -> None:
    source = files("contracts.privacy").joinpath("records.py").read_text(encoding="utf-8")
    assert f"RETENTION_MAX_MS = {RETENTION_MAX_MS}\n" in source
    store = MemoryStore()
    assert await Retention(store).find_cutoff(1, None) == (0, HeldBy.NOTHING)
    with pytest.raises(BlockRobotError, match=r"^STORAGE_DAMAGED:"):
        Retention(store).earliest()


@pytest.mark.parametrize(("age_ms", "below"), [(BLOCKS_KEPT_MS, 0), (BLOCKS_KEPT_MS + 1, 1)])
async def test_a_block_goes_a_retention_and_a_transactions_lifetime_after_its_time(age_ms: int, below: int) -> None:
    chain = RecordingChain()
    chain.block(1)
    chain.block(age_ms - 1)
    assert (await cutoff_of(chain)).height == below


async def test_a_record_under_a_claim_keeps_its_block_and_those_above_but_not_for_ever() -> None:
    chain = RecordingChain()
    chain.block(1)
    chain.block(1, Recorded(30 * DAY_MS, claimed_ms=3 * RETENTION_MAX_MS))
    chain.block(1)
    chain.block(BLOCKS_KEPT_MS + DAY_MS)
    assert await cutoff_of(chain) == (2, HeldBy.RECORD)
    chain.block(LIVE_RECORD_HELD_MAX_MS - BLOCKS_KEPT_MS)
    assert await cutoff_of(chain) == (4, HeldBy.NOTHING)


@pytest.mark.parametrize("status", ["erased", "expired"])
async def test_a_record_that_is_gone_keeps_nothing(status: str) -> None:
    chain = RecordingChain()
    chain.block(1, Recorded(30 * DAY_MS, status, claimed_ms=2 * RETENTION_MAX_MS))
    chain.block(BLOCKS_KEPT_MS + DAY_MS)
    assert await cutoff_of(chain) == (2, HeldBy.NOTHING)


async def test_a_search_goes_on_where_it_stopped_once_the_record_is_erased() -> None:
    chain = RecordingChain()
    chain.block(1, Recorded(30 * DAY_MS), Recorded(30 * DAY_MS, claimed_ms=2 * RETENTION_MAX_MS))
    for _ in range(20):
        chain.block(1)
    chain.block(BLOCKS_KEPT_MS + DAY_MS)
    store = await chain.store()
    retention = Retention(store)
    assert await retention.find_cutoff(1, None) == (1, HeldBy.RECORD)
    key = RECORD.key((1).to_bytes(8) + (1).to_bytes(8))
    chain.extend({key: stored(RecordRow, owner=OWNER, status="erased")}, transactions=0, later_ms=1)
    await chain.fill(store)
    assert await retention.find_cutoff(1, None) == (22, HeldBy.NOTHING)


async def test_what_keeps_an_old_block_is_named() -> None:
    chain = RecordingChain()
    for _ in range(10):
        chain.block(1)
    chain.block(BLOCKS_KEPT_MS + DAY_MS)
    assert await cutoff_of(chain, keep=4) == (8, HeldBy.FLOOR)
    assert await cutoff_of(chain, keep=4, followed=3) == (4, HeldBy.CUSTODIAN)
    assert await cutoff_of(chain, keep=4, followed=-1) == (0, HeldBy.CUSTODIAN)


RECORDS = st.builds(
    Recorded,
    retention_ms=st.integers(DAY_MS, RETENTION_MAX_MS),
    status=st.sampled_from(["active", "erasing", "expired", "erased"]),
    claimed_ms=st.sampled_from([0, 0, RETENTION_MAX_MS, 2 * RETENTION_MAX_MS, 3 * RETENTION_MAX_MS]),
)
BLOCKS = st.tuples(st.one_of(st.integers(1, 60_000), st.integers(1, RETENTION_MAX_MS)), st.lists(RECORDS, max_size=2))


@given(blocks=st.lists(BLOCKS, min_size=1, max_size=14), keep=st.integers(1, 6), behind=st.none() | st.integers(0, 15))
def test_nothing_goes_that_is_needed_and_nothing_stays_that_is_not(
    blocks: list[tuple[int, list[Recorded]]], keep: int, behind: int | None
) -> None:
    """Held against the rule itself, block by block."""
    chain = RecordingChain()
    for later_ms, records in blocks:
        chain.block(later_ms, *records)
    head, times = len(blocks), [block.header.timestamp_ms for block in chain.blocks]
    now_ms = times[-1]
    followed = None if behind is None else max(-1, head - behind)
    recorded: list[list[Recorded]] = [[], *(records for _, records in blocks)]

    def lives(height: int, each: Recorded) -> bool:
        kept_ms = max(each.retention_ms, each.claimed_ms)
        return each.status in {"active", "erasing"} and times[height] + kept_ms > now_ms

    def may_go(height: int) -> bool:
        age_ms = now_ms - times[height]
        holds_live = any(lives(height, each) for each in recorded[height])
        return (
            age_ms > RETENTION_MAX_MS + TRANSACTION_LIFETIME_MAX_MS
            and height <= head - keep
            and (followed is None or height <= followed)
            and (not holds_live or age_ms > 2 * RETENTION_MAX_MS + TRANSACTION_LIFETIME_MAX_MS)
        )

    cutoff = asyncio.run(cutoff_of(chain, keep, followed))
    assert all(may_go(height) for height in range(cutoff.height))
    assert not may_go(cutoff.height)
    # A transaction of a block that goes was valid for ten minutes from then at most: no later block takes it again.
    assert all(times[height] + TRANSACTION_LIFETIME_MAX_MS < now_ms for height in range(cutoff.height))


@given(gaps=st.lists(st.integers(1, 100), min_size=1, max_size=30), since=st.integers(0, 3_100))
def test_the_first_block_since_a_time_is_found(gaps: list[int], since: int) -> None:
    chain = RecordingChain()
    for gap in gaps:
        chain.block(gap)
    times = [block.header.timestamp_ms for block in chain.blocks]
    since_ms = times[0] + since
    expected = next((height for height, time_ms in enumerate(times) if time_ms >= since_ms), len(times))

    async def find() -> int:
        with (await chain.store()).snapshot() as view:
            return find_first_since(view, since_ms, 0, len(times) - 1)

    assert asyncio.run(find()) == expected

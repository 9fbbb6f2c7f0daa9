"""The scrub: every way in which chain and store can differ is found, and only what is missing is put right."""

from __future__ import annotations

from collections.abc import AsyncIterator
from dataclasses import replace
from pathlib import Path

import pytest

from consensus.records.commitments import ciphertext_root, commitment_root
from node.offchain.custodian import Custodian
from node.offchain.erase_keys import EraseKeys
from node.offchain.scrub import ChainRecord, scrub
from node.offchain.store import CustodyStore, RecordFacts
from tests.offchain.small_chain import (
    ALICE,
    BOB,
    CUSTODIAN,
    EXPIRES_MS,
    RecordedClip,
    SmallChain,
    record_clip,
    recorded,
)


class ChainState:
    """The records of a finalized state, as far as a scrub asks for them."""

    def __init__(self) -> None:
        self.kept: dict[bytes, ChainRecord] = {}

    def put(self, clip: RecordedClip, *, kept: bool = True, owner: bytes = ALICE, height: int = 1) -> None:
        roots = commitment_root(clip.upload.commitment_leaves), ciphertext_root(clip.leaves)
        facts = RecordFacts(clip.record_id, clip.upload.txid, owner, *roots, EXPIRES_MS, height)
        self.kept[clip.record_id] = ChainRecord(facts, kept)

    async def records(self) -> AsyncIterator[ChainRecord]:
        for record in self.kept.values():
            yield record


@pytest.fixture
async def custodian(store: CustodyStore, tmp_path: Path) -> AsyncIterator[Custodian]:
    chain = SmallChain()
    with EraseKeys(tmp_path / "erase-keys") as keys:
        yield Custodian(store, keys, member=CUSTODIAN, clock_ms=lambda: chain.time_ms)


async def hold(custodian: Custodian, *clips: RecordedClip) -> None:
    chain = SmallChain()
    for clip in clips:
        await custodian.stage(clip.upload)
    await custodian.on_finalized_block(chain.block(*(recorded(clip) for clip in clips)))


async def test_a_store_that_agrees_with_the_chain_is_clean(custodian: Custodian, store: CustodyStore) -> None:
    clips, state = [record_clip() for _ in range(3)], ChainState()
    await hold(custodian, *clips)
    for clip in clips:
        state.put(clip)
    report = await scrub(custodian, store, state)
    assert report.is_clean
    assert report.compared_count == 3


async def test_what_the_store_lost_is_put_among_the_missing(custodian: Custodian, store: CustodyStore) -> None:
    held, lost, ahead, state = record_clip(), record_clip(), record_clip(), ChainState()
    await hold(custodian, held)
    state.put(held)
    state.put(lost)
    state.put(ahead, height=2)
    report = await scrub(custodian, store, state)
    assert report.missing == [lost.record_id]
    assert not report.is_clean
    assert [facts.record_id for facts in await custodian.missing(10)] == [lost.record_id]


async def test_what_should_not_be_there_is_reported_and_left_for_a_person(
    custodian: Custodian, store: CustodyStore
) -> None:
    erased, unknown, foreign, state = record_clip(), record_clip(), record_clip(), ChainState()
    await hold(custodian, erased, unknown, foreign)
    state.put(erased, kept=False)
    state.put(foreign, owner=BOB)
    report = await scrub(custodian, store, state)
    assert report.held_though_erased == [erased.record_id]
    assert report.unknown_to_chain == [unknown.record_id]
    assert report.other_roots == [foreign.record_id]
    assert report.missing == []
    assert len(await store.clips([erased.record_id, unknown.record_id, foreign.record_id])) == 3


async def test_a_changed_byte_is_found_in_its_frame(custodian: Custodian, store: CustodyStore) -> None:
    clip, state = record_clip(), ChainState()
    await hold(custodian, clip)
    state.put(clip)
    row, frames = (await store.clips([clip.record_id]))[clip.record_id], await store.frames(clip.record_id)
    changed = frames[2].ciphertext[:-1] + bytes((frames[2].ciphertext[-1] ^ 1,))
    await store.stage(row, [*frames[:2], replace(frames[2], ciphertext=changed)])
    report = await scrub(custodian, store, state)
    assert report.corrupted == [(clip.record_id, 2)]
